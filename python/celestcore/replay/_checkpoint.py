"""How far a replay has come, in a file that is whole or not there."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._check import FloatArray
from celestcore._files import replacing
from celestcore.errors import InputError

__all__ = ["Checkpoint", "read_checkpoint"]

KIND = "celestcore replay checkpoint"
VERSION = 1


@dataclass(frozen=True)
class Checkpoint:
    """What a replay needs to go on from where it was.

    Attributes
    ----------
    job : str
        Digest of the navigator, the options and the log: another job does not go on from it.
    upto : float
        The last window that was read: where it ends [s], or its place.
    parts : int
        Parts of the output that are complete.
    state : dict or None
        Time [s], attitude, bias [rad/s] and covariance at the last row; None before the start.
    counts : dict
        What has been counted so far.

    Examples
    --------
    >>> Checkpoint("digest", 180.0, 3, None, {"rows": 10}).parts
    3
    """

    job: str
    upto: float
    parts: int
    state: dict[str, Any] | None
    counts: dict[str, Any]

    def write(self, path: str | os.PathLike[str]) -> None:
        """Write the file: whole, or as it was before.

        Parameters
        ----------
        path : path
            Of the file.

        Raises
        ------
        InputError
            If the directory does not exist.
        OSError
            If the disk is full.

        Examples
        --------
        >>> from tempfile import TemporaryDirectory
        >>> with TemporaryDirectory() as folder:
        ...     Checkpoint("digest", 60.0, 1, None, {}).write(f"{folder}/c.json")
        ...     read_checkpoint(f"{folder}/c.json").upto
        60.0
        """
        payload = json.dumps(_plain(asdict(self)), sort_keys=True)
        text = json.dumps(
            {"kind": KIND, "version": VERSION, "sha256": _digest(payload), "payload": payload}
        )
        with replacing(path) as temporary:
            write_through(temporary, text.encode())
        sync_folder(Path(path).resolve().parent)


def read_checkpoint(path: str | os.PathLike[str]) -> Checkpoint:
    """Read a checkpoint.

    Parameters
    ----------
    path : path
        Of the file.

    Returns
    -------
    Checkpoint

    Raises
    ------
    InputError
        If there is none, it is damaged, or of another version.

    Examples
    --------
    >>> read_checkpoint("nowhere.json")  # doctest: +ELLIPSIS
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: checkpoint, value 'nowhere.json': there is no such file...
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(
            "there is no such file: run once without resume",
            field="checkpoint",
            value=os.fspath(path),
        ) from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(
            f"cannot be read: {error}", field="checkpoint", value=os.fspath(path)
        ) from error
    try:
        outer = json.loads(text)
        kind, version = outer["kind"], outer["version"]
        payload, digest = outer["payload"], outer["sha256"]
    except (ValueError, KeyError, TypeError):
        raise _damaged(path, "it is no checkpoint of celestcore") from None
    if kind != KIND:
        raise _damaged(path, "it is no checkpoint of celestcore")
    if version != VERSION:
        raise InputError(
            f"has version {version!r}, but this celestcore reads {VERSION}: finish the replay with "
            "the celestcore that began it, or begin anew",
            field="checkpoint",
            value=os.fspath(path),
        )
    if not isinstance(payload, str) or _digest(payload) != digest:
        raise _damaged(path, "its checksum does not fit")
    made = json.loads(payload)
    names = {f.name for f in fields(Checkpoint)}
    return Checkpoint(**{name: _restored(value) for name, value in made.items() if name in names})


def _damaged(path: str | os.PathLike[str], why: str) -> InputError:
    return InputError(
        f"{why}: the file is damaged; begin anew", field="checkpoint", value=os.fspath(path)
    )


def _digest(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def _plain(value: Any) -> Any:
    """Return what JSON holds exactly: arrays as hexadecimal floats with their shape."""
    if isinstance(value, np.ndarray):
        flat = [float(x).hex() for x in value.reshape(-1)]
        return {"__array__": flat, "shape": list(value.shape)}
    if isinstance(value, np.generic):
        return _plain(value.item())
    if isinstance(value, float):
        return {"__float__": value.hex()}
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    return value


def _restored(value: Any) -> Any:
    if isinstance(value, dict):
        if "__array__" in value:
            out: FloatArray = np.array([float.fromhex(x) for x in value["__array__"]])
            return out.reshape(value["shape"])
        if "__float__" in value:
            return float.fromhex(value["__float__"])
        return {name: _restored(item) for name, item in value.items()}
    if isinstance(value, list):
        return [_restored(item) for item in value]
    return value


def write_through(path: Path, content: bytes) -> None:
    """Write a file and wait until the disk has it."""
    with path.open("wb") as file:
        file.write(content)
        file.flush()
        os.fsync(file.fileno())


def sync_folder(folder: Path) -> None:
    """Wait until the disk knows a renamed file's new name."""
    if os.name != "posix":
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
