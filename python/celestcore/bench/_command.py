"""What ``celestcore bench`` does: check, measure, write."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from celestcore._files import check_output, replacing
from celestcore.bench._measure import measure
from celestcore.bench._report import Report
from celestcore.bench._session import Progress
from celestcore.errors import InputError

STDOUT = "-"


@dataclass(frozen=True)
class Bench:
    """What was asked for; `check` before `run`, `write` at the end."""

    against: Sequence[str] = ()
    only: str | None = None
    repeats: int | None = None
    quick: bool = False
    instructions: Path | None = None
    json: str | None = None
    markdown: str | None = None

    def check(self) -> None:
        """Refuse what cannot be written, before anything is measured.

        Raises
        ------
        InputError
            A directory that does not exist, two outputs of one name.
        """
        named = {"--json": self.json, "--markdown": self.markdown}
        if self.json is not None and self.json == self.markdown:
            raise InputError("is the same as --json", field="--markdown", value=self.markdown)
        for option, path in named.items():
            if path not in (None, STDOUT):
                check_output(str(path), option)

    @property
    def to_stdout(self) -> bool:
        """Whether an output goes to standard output, where tables for people must not."""
        return STDOUT in (self.json, self.markdown)

    def run(self, progress: Progress | None = None) -> Report:
        """Measure."""
        only = None if self.only is None else [self.only]
        return measure(
            only,
            self.against,
            repeats=self.repeats,
            quick=self.quick,
            instructions=self.instructions,
            progress=progress,
        )

    def write(self, report: Report) -> list[tuple[str, Path]]:
        """Write the files beside their places first, then rename them.

        Returns
        -------
        list of (str, Path)
            What each is, and its name.
        """
        texts = {
            "figures": (self.json, json.dumps(report.to_dict(), indent=2, allow_nan=False) + "\n"),
            "section": (self.markdown, report.to_markdown()),
        }
        written: list[tuple[str, Path]] = []
        with ExitStack() as stack:
            for what, (place, text) in texts.items():
                if place == STDOUT:
                    sys.stdout.write(text)
                elif place is not None:
                    ready = stack.enter_context(replacing(place))
                    ready.write_text(text, encoding="utf-8")
                    written.append((what, Path(place)))
        return written
