"""What ``celestcore reproduce`` does with an experiment: check, run, write."""

from __future__ import annotations

import json
import os
import sys
from contextlib import ExitStack
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from celestcore._files import check_output, replacing
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.reproduce._html import drawn

if TYPE_CHECKING:
    from celestcore.reproduce._target import Target
    from celestcore.reproduce.star_gyro import Progress

STDOUT = "-"
PAGE = "index.html"
RESULT = "result.json"
EXPERIMENTS = {
    "star-gyro": ("star_gyro", ""),
    "celestial-orbit": ("celestial_orbit", "_orbit"),
    "gnss-star": ("gnss_star", "_gnss"),
}
"""Of each experiment the module that runs it, and what the names of its other parts begin with."""


class Outcome(Protocol):
    """What every experiment's result can do."""

    def to_dict(self) -> dict[str, Any]:
        """Return every figure, ready for JSON."""

    def targets(self) -> list[Target]:
        """Return what was asked and what came out."""


@dataclass(frozen=True)
class Reproduce:
    """What was asked for; `check` before `run`, `write` at the end."""

    experiment: str
    runs: int | None = None
    seed: int = 0
    threads: int | None = None
    quick: bool = False
    json: str | None = None
    out: Path | None = None

    def check(self) -> None:
        """Refuse what cannot be written, before anything is computed.

        Raises
        ------
        InputError
            If `out` is a file or cannot be made, or `json` cannot be written.
        MissingDependencyError
            If `out` is asked for and matplotlib is not installed.
        """
        if self.json not in (None, STDOUT):
            check_output(str(self.json), "--json")
        if self.out is None:
            return
        require("matplotlib.figure", extra="plot", what="the page")
        if self.out.exists() and not self.out.is_dir():
            raise InputError(f"is a file, not a folder: {self.out}", field="--out")
        near = Path(os.path.realpath(self.out))
        while not near.exists():
            near = near.parent
        if not os.access(near, os.W_OK):
            raise InputError(f"cannot make {self.out}: {near} is not writable", field="--out")

    def run(self, progress: Progress | None = None) -> Outcome:
        """Run the experiment."""
        found: Outcome = self._part("").run(
            self.runs, self.seed, threads=self.threads, quick=self.quick, progress=progress
        )
        return found

    def lead(self, result: Outcome) -> str:
        """Return the outcome in a few sentences."""
        return str(self._part("_page").lead(result))

    def write(self, result: Outcome, command: str) -> list[tuple[str, Path]]:
        """Write all files beside their places first, then rename them.

        Returns
        -------
        list of (str, Path)
            What each is, and its name.
        """
        text = json.dumps(result.to_dict(), indent=2, allow_nan=False) + "\n"
        files: dict[Path, bytes] = {}
        named: list[tuple[str, Path]] = []
        if self.out is not None:
            self.out.mkdir(parents=True, exist_ok=True)
            contents = {**self._contents(result, command), RESULT: text.encode()}
            files = {self.out / name: data for name, data in contents.items()}
            named.append(("page", self.out / PAGE))
        if self.json not in (None, STDOUT):
            files[Path(str(self.json))] = text.encode()
            named.append(("figures", Path(str(self.json))))
        with ExitStack() as stack:
            for path, data in files.items():
                stack.enter_context(replacing(path)).write_bytes(data)
        if self.json == STDOUT:
            sys.stdout.write(text)
        return named

    def _contents(self, result: Outcome, command: str) -> dict[str, bytes]:
        pictures = drawn(self._part("_figures").figures(result))
        return {
            PAGE: str(self._part("_page").page(result, command, pictures)).encode(),
            **{n: text.encode() for n, text in self._part("_tables").csv_tables(result).items()},
            **{f"{name}.svg": data for name, data in pictures.items()},
        }

    def _part(self, what: str) -> Any:
        """Import a module of the experiment: the one that runs it, its page, ..."""
        module, prefix = EXPERIMENTS[self.experiment]
        return import_module(f"celestcore.reproduce.{prefix + what if what else module}")
