"""CCSDS navigation messages as files: the library, versions, and errors that name the place."""

from __future__ import annotations

import os
import re
from datetime import datetime, timezone
from pathlib import Path
from types import ModuleType
from typing import Any

from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError, LogFormatError, MissingDependencyError

_KIND = re.compile(r"CCSDS_([A-Z]{3})_VERS\"?\s*(?:=|version=\")\s*(\d+)")
_WITHDRAWN = {
    "direction": re.compile(
        r"^[ \t]*ATTITUDE_DIR[ \t]*=[ \t]*(\w+)[ \t]*$|<ATTITUDE_DIR>\s*(\w+)\s*</\w+>", re.M
    ),
    "scalar": re.compile(
        r"^[ \t]*QUATERNION_TYPE[ \t]*=[ \t]*(\w+)[ \t]*$|<QUATERNION_TYPE>\s*(\w+)\s*</\w+>", re.M
    ),
}
_LINE = re.compile(r"line (\d+)")
_LONGEST = 200


def library() -> ModuleType:
    """Import the library.

    Raises
    ------
    MissingDependencyError
        If it is not installed, or another package of the same import name is in its place.
    """
    module = require("ccsds_ndm", extra="ccsds", what="reading and writing CCSDS messages")
    if not hasattr(module, "AemData"):
        raise MissingDependencyError(
            "CCSDS messages need the package ccsds-ndm-py, but ccsds_ndm is another one "
            "(ccsds-ndm): pip uninstall ccsds-ndm; pip install 'celestcore[ccsds]'"
        )
    return module


def words(**given: Any) -> dict[str, str]:
    """Return names that go into a message: one line of text each.

    Raises
    ------
    InputError
        Names the first one that is no text, empty, or of several lines.
    """
    for field, value in given.items():
        if not isinstance(value, str) or not value.strip() or not value.isprintable():
            raise InputError("must be a line of text", field=field, value=value)
    return {field: value.strip() for field, value in given.items()}


def created(date: str | None) -> str:
    """Return the date of a message, now unless it is given."""
    now = datetime.now(timezone.utc).replace(tzinfo=None, microsecond=0)
    return now.isoformat() if date is None else words(creation_date=date)["creation_date"]


def save(path: str | os.PathLike[str], message: Any) -> None:
    """Write a message as XML where the name ends so, otherwise as KVN; replace the file at once.

    Raises
    ------
    InputError
        If the folder cannot be written to, or the library finds the message at fault.
    """
    name = os.fspath(path)
    form = "xml" if name.lower().endswith(".xml") else "kvn"
    try:
        text = message.to_str(form)
    except ValueError as error:
        raise InputError(_short(error)).located(name) from None
    with replacing(path) as temporary:
        temporary.write_text(text.rstrip("\n") + "\n", encoding="utf-8", newline="\n")


class Loaded:
    """A message read from a file: ``segments`` of the library, and what version 1 says besides.

    ``direction`` (``A2B`` or ``B2A``) and ``scalar`` (``FIRST`` or ``LAST``) are the keywords
    ATTITUDE_DIR and QUATERNION_TYPE of each segment of an AEM of version 1. Later versions have
    withdrawn them, and the library knows them no more.
    """

    def __init__(self, path: str | os.PathLike[str], kind: str) -> None:
        self.name = os.fspath(path)
        text = _text(path, self.name)
        found = _KIND.search(text)
        if found is None or found[1] != kind:
            what = "is no CCSDS message" if found is None else f"is an {found[1]}"
            raise LogFormatError(f"{what}; needed is an {kind}", source=self.name)
        self.old = kind == "AEM" and found[2] == "1"
        self.direction, self.scalar = (
            [(m[1] or m[2]).upper() for m in pattern.finditer(text)] if self.old else []
            for pattern in _WITHDRAWN.values()
        )
        if text.lstrip().startswith("<"):
            self.scalar = []  # XML names the four numbers
        if self.old:
            for pattern in _WITHDRAWN.values():
                text = pattern.sub("", text)
        reader = getattr(library(), kind.capitalize())
        try:
            self.message = reader.from_str(text)
        except ValueError as error:
            raise self._fault(error, text) from None
        self.segments: list[Any] = list(self.message.segments)

    def pick(self, segment: int | None) -> tuple[int, Any]:
        """Return the number and the segment asked for.

        Raises
        ------
        LogFormatError
            If there is none of that number, or several and none was named.
        """
        count = len(self.segments)
        if segment is None and count != 1:
            raise LogFormatError(
                f"has {count} segments: choose one with segment=0 ... {count - 1}",
                source=self.name,
            )
        number = 0 if segment is None else segment
        if not 0 <= number < count:
            raise LogFormatError(
                f"there are {count} segments", field="segment", value=segment, source=self.name
            )
        return number, self.segments[number]

    def keyword(self, name: str, segment: int, choices: tuple[str, str]) -> str:
        """Return a keyword of version 1 of a segment; the last choice where there is none.

        Raises
        ------
        LogFormatError
            If it is none of the choices, or only some of the segments have it.
        """
        values: list[str] = getattr(self, name)
        if not values:
            return choices[-1]
        if len(values) != len(self.segments) or values[segment] not in choices:
            listed = " or ".join(choices)
            raise LogFormatError(
                f"must be {listed} in every segment", field=name, value=values, source=self.name
            )
        return values[segment]

    def _fault(self, error: ValueError, text: str) -> LogFormatError:
        place = _LINE.search(str(error))
        lines = text.splitlines()
        line = int(place[1]) if place else 0
        value = lines[line - 1].strip() if 0 < line <= len(lines) else None
        return LogFormatError(
            _short(error),
            field=f"line {line}" if line else None,
            value=value,
            source=self.name,
        )


def _text(path: str | os.PathLike[str], name: str) -> str:
    try:
        return Path(path).read_text(encoding="utf-8")
    except OSError as error:
        raise LogFormatError(f"cannot be read ({error.strerror})", source=name) from None
    except UnicodeDecodeError:
        raise LogFormatError("is not a text file in UTF-8", source=name) from None


def _short(error: ValueError) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= _LONGEST else text[: _LONGEST - 3] + "..."
