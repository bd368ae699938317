"""The results: a folder of Parquet files, each complete or not there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.replay._checkpoint import sync_folder

LOCK = ".lock"
NOTE = b"celestcore"
LAYOUT = 1
"""Of the columns; another layout is another dataset."""


class Dataset:
    """One campaign's rows on disk."""

    def __init__(self, folder: Path, columns: Mapping[str, str], document: Any) -> None:
        self._arrow = require("pyarrow", extra="parquet", what="a campaign's results")
        self._parquet = require("pyarrow.parquet", extra="parquet", what="a campaign's results")
        self.folder = folder
        fields = [(name, getattr(self._arrow, kind)()) for name, kind in columns.items()]
        note = json.dumps({"campaign": LAYOUT, "document": document}, default=str)
        self.schema = self._arrow.schema(fields, metadata={NOTE: note.encode()})
        self._next = 0
        self._dropped: dict[Path, Any] = {}

    def begin(self) -> None:
        """Make the folder.

        Raises
        ------
        InputError
            If it cannot be written, or holds something else.
        """
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            why = f"cannot be made: {error.strerror or error}"
            raise InputError(why, field="out", value=os.fspath(self.folder)) from None
        if not os.access(self.folder, os.W_OK):
            raise InputError("is not writable", field="out", value=os.fspath(self.folder))
        for path in self.folder.iterdir():
            if not path.name.startswith((".", "_")) and not _is_part(path):
                raise InputError(
                    f"holds {path.name}, which is no part of a campaign: give another folder",
                    field="out",
                    value=os.fspath(self.folder),
                )

    @contextmanager
    def alone(self) -> Iterator[None]:
        """Refuse a second campaign that writes into the same folder."""
        if os.name != "posix":
            yield
            return
        import fcntl

        with (self.folder / LOCK).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                raise InputError(
                    "another campaign is writing into it", field="out", value=str(self.folder)
                ) from None
            except OSError:
                pass  # a file system without locks
            yield

    def finished(self) -> set[str]:
        """Return the keys of the rows that are there, but for those that a worker lost.

        Raises
        ------
        InputError
            If a part is damaged or of another campaign.
        """
        keys: set[str] = set()
        for path in parts(self.folder):
            table = self._checked(path)
            self._next = max(self._next, int(path.stem.removeprefix("part-")) + 1)
            good = [not lost for lost in table["lost"].to_pylist()]
            if not all(good):
                self._dropped[path] = table = table.filter(self._arrow.array(good))
            keys |= set(table["key"].to_pylist())
        return keys

    def clean(self) -> None:
        """Remove what was left half written, and rows that a worker lost: they are run again."""
        for path in self.folder.glob(".part-*.tmp*"):
            path.unlink()
        for path, kept in self._dropped.items():
            if len(kept):
                self._write(path, kept)
            else:
                path.unlink()

    def _checked(self, path: Path) -> Any:
        table = load(self._parquet, path)
        missing = set(self.schema.names) ^ set(table.schema.names)
        if not table.schema.equals(self.schema, check_metadata=False):
            what = f": {', '.join(sorted(missing))}" if missing else ", or columns of another type"
            raise InputError(
                f"is of another campaign, with other columns{what}: give another folder",
                source=os.fspath(path),
            )
        return table

    def write(self, pieces: Sequence[Mapping[str, Sequence[Any]]]) -> None:
        """Write rows as one more part.

        Raises
        ------
        OSError
            If the disk is full; the parts that are complete stay.
        """
        arrays = [
            self._arrow.array(
                [value for piece in pieces for value in piece[field.name]],
                type=field.type,
                from_pandas=True,
            )
            for field in self.schema
        ]
        made = self._arrow.Table.from_arrays(arrays, schema=self.schema)
        self._write(self.folder / f"part-{self._next:06d}.parquet", made)

    def turn(self) -> None:
        """Go on to the next part; until then, `write` replaces the last one."""
        self._next += 1

    def _write(self, path: Path, table: Any) -> None:
        with replacing(path) as temporary:
            self._parquet.write_table(
                table, temporary, compression="zstd", write_page_checksum=True
            )
            handle = os.open(temporary, os.O_RDONLY)
            try:
                os.fsync(handle)
            finally:
                os.close(handle)
        sync_folder(path.parent)


def _is_part(path: Path) -> bool:
    number = path.stem.removeprefix("part-")
    return path.suffix == ".parquet" and path.stem.startswith("part-") and number.isdecimal()


def parts(folder: Path) -> list[Path]:
    """Return the parts of a dataset in order."""
    return sorted((p for p in folder.glob("part-*.parquet") if _is_part(p)), key=lambda p: p.name)


def load(parquet: Any, path: Path) -> Any:
    """Read one part, every page checked against its checksum.

    Raises
    ------
    InputError
        If it is damaged, or no part of a campaign.
    """
    try:
        table = parquet.ParquetFile(path, page_checksum_verification=True).read()
    except (OSError, ValueError) as error:  # ArrowInvalid is a ValueError
        reason = " ".join(str(error).split())
        raise InputError(
            f"is damaged ({reason[:200]}): delete it, and its runs are run again",
            source=os.fspath(path),
        ) from None
    if NOTE not in (table.schema.metadata or {}):
        raise InputError("is no part of a campaign", source=os.fspath(path))
    return table
