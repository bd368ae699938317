"""Output files: checked before anything is computed, never left half written."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from celestcore.errors import InputError


def check_output(path: str | os.PathLike[str], field: str | None = None) -> Path:
    """Return the real path of a file to be written.

    Raises
    ------
    InputError
        If its directory does not exist or cannot be written to, or if it is a directory.
    """
    target = Path(os.path.realpath(path))
    problem = ""
    if not target.parent.is_dir():
        problem = f"the directory {target.parent} does not exist: create it first"
    elif target.is_dir():
        problem = "it is a directory: give a file name"
    elif not os.access(target.parent, os.W_OK):
        problem = f"the directory {target.parent} is not writable"
    if problem:
        raise InputError(f"cannot write {os.fspath(path)}: {problem}", field=field)
    return target


@contextmanager
def replacing(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Give a temporary path beside `path`; rename it to `path` if the block succeeds.

    Raises
    ------
    InputError
        If the directory does not exist or cannot be written to.
    """
    target = check_output(path)
    temporary = target.with_name(f".{target.stem}.{secrets.token_hex(4)}.tmp{target.suffix}")
    try:
        yield temporary
        os.replace(temporary, target)
    finally:
        temporary.unlink(missing_ok=True)


def check_outputs(
    outputs: Iterable[tuple[str, Path | None]], inputs: Iterable[Path | None]
) -> None:
    """Refuse files that cannot be written, or would overwrite each other or what is read.

    Raises
    ------
    InputError
        Names the option.
    """
    targets: dict[Path, str] = {}
    sources = [Path(os.path.realpath(source)) for source in inputs if source is not None]
    for option, path in outputs:
        if path is None:
            continue
        target = check_output(path, option)
        if target in targets:
            raise InputError(f"is the same file as {targets[target]}: {path}", field=option)
        targets[target] = option
        for source in sources:
            if target == source or (source.is_dir() and source in target.parents):
                raise InputError(f"would write into the input {source}", field=option)
