"""A folder of logs: which there are, what is in them, and a row of numbers for each."""

from __future__ import annotations

import hashlib
import json
import math
import os
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Any

from celestcore import _reading
from celestcore._tables import table_kind
from celestcore.campaign._schema import LOGS, SCORED, checked, table
from celestcore.config import Settings
from celestcore.errors import InputError, LogFormatError, MissingDependencyError, NumericalError
from celestcore.formats._registry import choose
from celestcore.io import read_log
from celestcore.log import SensorLog
from celestcore.solution import Solution
from celestcore.summary import innovation, span_s

COUNTS = ("samples", "fixes", "accepted", "rejected", "start", "missing", "outside", "gaps")
AXES = ("ax", "ay", "az", "bx", "by", "bz")
NUMBERS = (
    *("nis", "nis_per_dof", "nis_inside_95", "log_likelihood", "span_s", "final_t"),
    *(f"final_sigma_{axis}" for axis in AXES),
    *(f"final_bias_{axis}" for axis in "xyz"),
    "elapsed_s",
)
CHUNK = 1 << 20


def settings_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Check the tables of a campaign over logs, and return what its runs need.

    Raises
    ------
    InputError
        Names the table, the key and the value.
    """
    if "scenario" in document or "assumed" in document:
        raise InputError("goes without [scenario] and [assumed]", field="[logs]")
    options = checked("campaign", document.get("campaign", {}), SCORED)
    reading = _split(document.get("logs", {}))[1]
    rest = {n: v for n, v in document.items() if n not in ("campaign", "grid", "logs")}
    return {
        "over": Settings.from_dict(rest).tables,
        "smooth": options.get("smooth", False),
        "portable": options.get("portable", False),
        **({"reading": reading} if reading else {}),
    }


def _split(values: Any) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return what ``[logs]`` says of where logs are, and of how they are to be read."""
    given = table("logs", values)
    reading = {n: _plain(v) for n, v in given.items() if n in _reading.NAMES}
    _reading.from_table("logs", reading)
    where = {n: v for n, v in given.items() if n not in reading}
    unknown = [n for n in where if n not in LOGS]
    if unknown:
        known = ", ".join((*LOGS, *_reading.NAMES))
        raise InputError(f"unknown key; known are {known}", field=f"logs.{unknown[0]}")
    return where, reading


def _plain(value: Any) -> Any:
    """Return a value with TOML's dates as texts, so that it can travel as JSON."""
    if isinstance(value, Mapping):
        return {str(name): _plain(item) for name, item in value.items()}
    return value.isoformat() if hasattr(value, "isoformat") else value


def found(values: Any, base: Path) -> dict[str, Path]:
    """Return the logs that ``[logs]`` names, by their names within the folder.

    Raises
    ------
    InputError
        If there is no such folder, or no log in it.
    """
    where, reading = _split(values)
    given = checked("logs", where, LOGS)
    if "folder" not in given:
        raise InputError("is needed", field="logs.folder")
    folder = base / given["folder"]
    if not folder.is_dir():
        raise InputError("there is no such folder", field="logs.folder", value=os.fspath(folder))
    pattern = given.get("pattern", "*")
    try:
        matching = sorted(folder.glob(pattern))
    except (ValueError, NotImplementedError) as error:
        text = f"cannot be used: {error}"
        raise InputError(text, field="logs.pattern", value=pattern) from None
    logs = {
        path.relative_to(folder).as_posix(): path for path in matching if _is_log(path, reading)
    }
    if not logs:
        raise InputError(
            f"no log in {folder} matches it: a folder of Parquet tables, an .npz, a .csv or what "
            "'celestcore formats' lists",
            field="logs.pattern",
            value=pattern,
        )
    return logs


def _is_log(path: Path, reading: Mapping[str, Any]) -> bool:
    """Tell a log from what else may lie there; of a format that was named every file is one."""
    if path.is_dir():
        return any(_is_table(entry) for entry in path.iterdir())
    if path.name.startswith((".", "_")) or path.suffix.lower() == ".toml":
        return False
    if "format" in reading:
        return True
    try:
        choose(path, None)
    except LogFormatError:
        return False
    return path.suffix.lower() != ".parquet"  # a table of the log that its folder is


def _is_table(entry: Path) -> bool:
    """Tell ``gyro.parquet`` and the datasets ``gyro/`` and ``sensor=gyro/``."""
    name = entry.name.removesuffix(".parquet").rpartition("=")[2]
    if table_kind(name) is None:
        return False
    return any(entry.rglob("*.parquet")) if entry.is_dir() else entry.suffix == ".parquet"


def digest(path: Path) -> str:
    """Return a digest of all bytes of a log and of the TOML file that goes with it."""
    out = hashlib.sha256()
    for file in _files(path):
        name = file.relative_to(path).as_posix() if path.is_dir() else file.name
        out.update(f"{name}\0{file.stat().st_size}\0".encode())
        with file.open("rb") as content:
            while chunk := content.read(CHUNK):
                out.update(chunk)
    return out.hexdigest()


def _files(path: Path) -> Iterator[Path]:
    if path.is_dir():
        yield from sorted(f for f in path.rglob("*") if f.suffix in (".parquet", ".toml"))
        return
    yield path
    sidecar = path.with_suffix(".toml")
    if sidecar.exists():
        yield sidecar


def row(text: str, path: str, progress: Callable[[int, int], object]) -> dict[str, list[Any]]:
    """Replay one log, and return its numbers; of a log that cannot be replayed, the reason."""
    settings = json.loads(text)
    try:
        log = read_log(path, **_reading.from_table("logs", settings.get("reading", {})))
        solution = _replayed(log, settings, progress)
    except (MissingDependencyError, OSError):
        raise  # the machine's fault, not the log's
    except (InputError, NumericalError) as error:
        if isinstance(error.__cause__, OSError):
            raise error.__cause__ from None
        empty = dict.fromkeys((*COUNTS, *NUMBERS))
        return {name: [value] for name, value in {**empty, "failure": _words(error, path)}.items()}
    return {name: [value] for name, value in {**_numbers(solution, log), "failure": None}.items()}


def _words(error: Exception, path: str) -> str:
    """Return the reason without the path, which differs from machine to machine."""
    return str(error).removeprefix(f"{path}: ").replace(path, Path(path).name)


def _replayed(
    log: SensorLog, settings: Mapping[str, Any], progress: Callable[[int, int], object]
) -> Solution:
    own = Settings.from_log(log).merged(settings["over"])
    if log.gyro is None:
        raise InputError("this log has no gyro to replay", field="gyro")
    nav = own.navigator()
    run = nav.smooth if settings["smooth"] else nav.run
    return run(
        log,
        sigma0=own.sigma0(),
        every=max(1, len(log.gyro)),  # rows are not looked at
        innovations="nis",
        portable=settings["portable"],
        progress=progress,
    )


def _numbers(solution: Solution, log: SensorLog) -> dict[str, Any]:
    told, final = innovation(solution, solution.accepted), solution.final
    sigma = final.get("sigma", [math.nan] * 6)
    bias = final.get("bias", [math.nan] * 3)
    return {
        **{name: int(solution.counts.get(name, 0)) for name in COUNTS},
        "nis": told["nis_mean"],
        "nis_per_dof": told["nis_per_dof"],
        "nis_inside_95": told["inside_95"],
        "log_likelihood": solution.log_likelihood,
        "span_s": span_s(solution, log),
        "final_t": float(final.get("t", math.nan)),
        **{f"final_sigma_{axis}": float(v) for axis, v in zip(AXES, sigma, strict=True)},
        **{f"final_bias_{axis}": float(v) for axis, v in zip("xyz", bias, strict=True)},
        "elapsed_s": solution.elapsed_s,
    }
