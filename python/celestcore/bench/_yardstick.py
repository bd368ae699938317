"""A program of its own that does some of the works and prints how long they take."""

from __future__ import annotations

import json
import math
import os
import shlex
import shutil
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from celestcore.errors import InputError

TIMEOUT = 900.0
"""Longest run of the program [s]."""
HISTORY = {"a_prop": "history"}
"""Tasks of which only those lines count whose peer has this word: they store what they compute."""
SHOWN = 80


@dataclass
class Yardstick:
    """Fastest time of each task so far.

    Attributes
    ----------
    command : list of str
        The program and its arguments.
    found : dict of str to (float, str)
        For each task the time [ns] and who took it.
    """

    command: list[str]
    found: dict[str, tuple[float, str]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """The program's name without its folder."""
        return Path(self.command[0]).name

    def run(self) -> None:
        """Run the program once more.

        Raises
        ------
        InputError
            It cannot be started, fails, or does not print what it should.
        """
        try:
            done = subprocess.run(
                self.command, capture_output=True, text=True, timeout=TIMEOUT, errors="replace"
            )
        except subprocess.TimeoutExpired:
            raise self._error(f"did not end within {TIMEOUT:g} s") from None
        except OSError as error:
            raise self._error(f"cannot be started: {error.strerror or error}") from None
        if done.returncode:
            words = done.stderr.strip().splitlines()
            raise self._error(f"failed with code {done.returncode}: {_short(words[-1:])}")
        self._read(done.stdout)

    def _read(self, text: str) -> None:
        before = len(self.found)
        for number, line in enumerate(text.splitlines(), 1):
            if not line.strip():
                continue
            task, peer, ns = self._line(number, line)
            if HISTORY.get(task, "") in peer and ns < self.found.get(task, (math.inf, ""))[0]:
                self.found[task] = (ns, peer)
        if not before and not self.found:
            raise self._error('printed no line like {"task": "b_mekf", "peer": "by hand", "ns": 9}')

    def _line(self, number: int, line: str) -> tuple[str, str, float]:
        try:
            told = json.loads(line)
        except json.JSONDecodeError:
            raise self._error(f"line {number} of its output is not JSON: {_short(line)}") from None
        if not isinstance(told, Mapping):
            raise self._error(f"line {number} of its output is no JSON object: {_short(line)}")
        task, peer, ns = told.get("task"), told.get("peer", ""), told.get("ns")
        if not isinstance(task, str) or not isinstance(peer, str):
            raise self._error(f"line {number} of its output names no task: {_short(line)}")
        if not isinstance(ns, int | float) or isinstance(ns, bool) or not 0.0 < ns < math.inf:
            raise self._error(f"line {number} of its output has no positive ns: {_short(line)}")
        return task, peer, float(ns)

    def _error(self, message: str) -> InputError:
        return InputError(message, field="--against", value=shlex.join(self.command))


def _short(text: str | list[str]) -> str:
    line = " ".join(text if isinstance(text, list) else [text]).strip() or "nothing was said"
    return line if len(line) <= SHOWN else line[: SHOWN - 3] + "..."


def program(text: str) -> Yardstick | None:
    """Return the program that an option names, or None if it looks like names of peers.

    Raises
    ------
    InputError
        It looks like a path, but nothing there can be run.
    """
    words = shlex.split(text)
    if not words:
        return None
    first = words[0]
    if os.sep not in first and not Path(first).is_file():
        return None
    if shutil.which(first) is None:
        raise InputError("is no program that can be run", field="--against", value=first)
    return Yardstick([os.path.abspath(first), *words[1:]])
