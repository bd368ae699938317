"""Read and write the small TOML files of logs and settings: tables of plain values."""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Mapping
from datetime import date, datetime
from pathlib import Path
from typing import Any

from celestcore._optional import require
from celestcore.errors import InputError, LogFormatError

if sys.version_info >= (3, 11):
    import tomllib


def load_toml(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a TOML file.

    Raises
    ------
    LogFormatError
        If it cannot be read or is no TOML.
    """
    try:
        text = Path(path).read_bytes().decode("utf-8")
        return parse_toml(text)
    except OSError as error:
        raise LogFormatError(
            f"cannot be read: {error.strerror or error}", source=os.fspath(path)
        ) from None
    except ValueError as error:  # TOMLDecodeError and UnicodeDecodeError are ValueErrors
        raise LogFormatError(f"is not valid TOML: {error}", source=os.fspath(path)) from None


def parse_toml(text: str) -> dict[str, Any]:
    """Parse TOML, by the standard library or, on Python 3.10, by tomli."""
    if sys.version_info >= (3, 11):
        return tomllib.loads(text)
    parsed: dict[str, Any] = require("tomli", extra="toml", what="reading TOML").loads(text)
    return parsed


def dump_toml(document: Mapping[str, Mapping[str, Any]]) -> str:
    """Write tables of strings, numbers, truth values and (nested) lists as TOML.

    Examples
    --------
    >>> print(dump_toml({"gyro": {"arw": 1e-06, "mounting": [1.0, 0.0, 0.0, 0.0]}}), end="")
    [gyro]
    arw = 1e-06
    mounting = [1.0, 0.0, 0.0, 0.0]
    """
    blocks = []
    for table, values in document.items():
        lines = [f"[{_key(table)}]"]
        lines += [f"{_key(k)} = {_value(v, f'{table}.{k}')}" for k, v in values.items()]
        blocks.append("\n".join(lines) + "\n")
    return "\n".join(blocks)


def _key(key: str) -> str:
    bare = key.replace("_", "").replace("-", "")
    return key if bare.isascii() and bare.isalnum() else _string(key)


def _string(text: str) -> str:
    return json.dumps(text, ensure_ascii=False).replace("\x7f", "\\u007f")


def _value(value: Any, field: str) -> str:
    convert = getattr(value, "tolist", None)
    if callable(convert):
        value = convert()
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, str):
        return _string(value)
    if isinstance(value, int | float):
        return repr(value)
    if isinstance(value, datetime | date):
        return value.isoformat()
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v, field) for v in value) + "]"
    raise InputError("cannot be written as TOML", field=field, value=value)
