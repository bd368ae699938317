"""What a campaign's folder holds: one row a run, and numbers for each cell."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._optional import require
from celestcore.campaign._config import Campaign
from celestcore.campaign._dataset import NOTE, load, parts
from celestcore.campaign._grid import canonical
from celestcore.campaign._logs import COUNTS, NUMBERS
from celestcore.errors import InputError
from celestcore.solution import package_version

if TYPE_CHECKING:
    import pandas as pd

ERRORS = ("rms", "rms_all", "rms_before", "rms_bias")
MEANS = ("nees_attitude", "nees", "nis", "accepted", "seconds")
SCORES = (
    *(f"{name}_{axis}" for name in ERRORS for axis in "xyz"),
    *MEANS,
    *(f"final_error_{axis}" for axis in ("ax", "ay", "az", "bx", "by", "bz")),
)
OF_RUN = ("seed", "trial", "log")
TAIL = {"failure": "string", "lost": "bool_", "version": "string"}
POOLED_LOGS = ("nis", "nis_per_dof", "log_likelihood", "span_s", "elapsed_s")
SUMS = ("samples", "fixes", "accepted", "rejected")


def columns_of(campaign: Campaign) -> dict[str, str]:
    """Return the columns of a campaign's rows, each with its Arrow type."""
    grid = {name: _type(values) for name, values in campaign.grid.items()}
    if campaign.logs:
        own = dict.fromkeys(COUNTS, "int64") | dict.fromkeys(NUMBERS, "float64")
        run = {"log": "string"}
    else:
        own = dict.fromkeys(SCORES, "float64")
        run = {"seed": "uint64", "trial": "int64"}
    return {"key": "string", **grid, **run, **own, **TAIL}


def _type(values: Sequence[Any]) -> str:
    if all(isinstance(v, bool) for v in values):
        return "bool_"
    if all(isinstance(v, int | float) and not isinstance(v, bool) for v in values):
        return "float64"
    if all(isinstance(v, str | list | tuple) for v in values):
        return "string"
    raise InputError("a list of the grid must hold values of one kind", field="grid", value=values)


def grid_value(value: Any) -> Any:
    """Return a grid's value as a row holds it: a list as text."""
    return canonical(value) if isinstance(value, list | tuple) else value


def read(folder: str | os.PathLike[str]) -> Any:
    """Read a campaign's rows, as far as there are any, in order of their settings and runs.

    Parameters
    ----------
    folder : path
        The campaign's `out`.

    Returns
    -------
    pyarrow.Table
        One row a run. ``key``; the grid's settings by their dotted names (lists as text); ``seed``
        and ``trial``, or ``log``; the scores, see `MonteCarlo.to_dataframe`, or of a log its counts
        and numbers; ``failure``, null if there was none; ``lost``, whether it was the worker's
        fault; ``version``. Scores of failed runs are null.

    Raises
    ------
    InputError
        If there is nothing, or a part is damaged.
    MissingDependencyError
        Without pyarrow.

    Examples
    --------
    >>> read("nowhere")
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: out, value 'nowhere': holds no campaign
    """
    arrow = require("pyarrow", extra="parquet", what="reading a campaign's results")
    parquet = require("pyarrow.parquet", extra="parquet", what="reading a campaign's results")
    found = [load(parquet, path) for path in parts(Path(folder))]
    if not found:
        raise InputError("holds no campaign", field="out", value=os.fspath(folder))
    plain = [table.replace_schema_metadata(None) for table in found]
    if any(not t.schema.equals(plain[0].schema) for t in plain):
        raise InputError("holds more than one campaign", field="out", value=os.fspath(folder))
    table = arrow.concat_tables(plain).replace_schema_metadata(
        {NOTE: found[-1].schema.metadata[NOTE]}
    )
    names = _grid_names(table) + [n for n in OF_RUN if n in table.column_names]
    return table.sort_by([(name, "ascending") for name in names])


def _grid_names(table: Any) -> list[str]:
    """Return the grid's columns: those with a dot in their names."""
    return [name for name in table.column_names if "." in name]


@dataclass(frozen=True, eq=False)
class Results:
    """What a call of `run` leaves.

    Attributes
    ----------
    folder : Path
        Where the rows are.
    runs : int
        How many the campaign has.
    ran, kept : int
        How many this call ran, and how many were there before.
    lost : int
        Runs of this call that were given up because their workers died.
    seconds : float
        How long the call took [s].

    Examples
    --------
    >>> from pathlib import Path
    >>> Results(Path("mine.runs"), 40, 30, 10, 0, 2.5)
    Results(40 runs in mine.runs, 30 of them new)
    """

    folder: Path
    runs: int
    ran: int
    kept: int
    lost: int
    seconds: float

    def __repr__(self) -> str:
        return f"Results({self.runs} runs in {self.folder}, {self.ran} of them new)"

    def table(self) -> Any:
        """Return all rows; see `read`.

        Returns
        -------
        pyarrow.Table

        Examples
        --------
        >>> import tempfile
        >>> from celestcore import campaign
        >>> flown = {"scenario": {"duration_s": 9}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     rows = campaign.run({**flown, "campaign": {"trials": 3}}, folder).table()
        >>> rows["trial"].to_pylist()
        [0, 1, 2]
        """
        return read(self.folder)

    def to_dataframe(self) -> pd.DataFrame:
        """Return all rows as a data frame.

        Returns
        -------
        pandas.DataFrame

        Raises
        ------
        MissingDependencyError
            Without pandas.

        Examples
        --------
        >>> import tempfile
        >>> from celestcore import campaign
        >>> flown = {"scenario": {"duration_s": 9}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     len(campaign.run({**flown, "campaign": {"trials": 3}}, folder).to_dataframe())
        3
        """
        require("pandas", extra="pandas", what="a data frame")
        frame: pd.DataFrame = self.table().to_pandas()
        return frame

    def cells(self) -> list[dict[str, Any]]:
        """Return numbers for each cell of the grid.

        Returns
        -------
        list of dict
            The grid's settings, ``runs`` and ``failed``; of trials the root mean square errors
            ``rms`` and so on (lists of three, [rad], [rad/s]) and means of NEES and NIS; of logs
            sums of the counts and means. None where nothing is left to pool.

        Examples
        --------
        >>> import tempfile
        >>> from celestcore import campaign
        >>> flown = {"scenario": {"duration_s": 9}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     cell, = campaign.run({**flown, "campaign": {"trials": 3}}, folder).cells()
        >>> cell["runs"], cell["failed"], len(cell["rms"])
        (3, 0, 3)
        """
        return pooled(self.table())

    def to_dict(self) -> dict[str, Any]:
        """Return everything but the rows, ready for JSON.

        Returns
        -------
        dict
            ``version``, ``out``, ``runs``, ``ran``, ``kept``, ``failed``, ``lost``, ``seconds`` and
            ``cells``, see `cells`.

        Examples
        --------
        >>> import tempfile
        >>> from celestcore import campaign
        >>> flown = {"scenario": {"duration_s": 9}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     campaign.run({**flown, "campaign": {"trials": 3}}, folder).to_dict()["failed"]
        0
        """
        cells = self.cells()
        return {
            "version": package_version(),
            "out": os.fspath(self.folder),
            "runs": self.runs,
            "ran": self.ran,
            "kept": self.kept,
            "failed": sum(cell["failed"] for cell in cells),
            "lost": self.lost,
            "seconds": self.seconds,
            "cells": cells,
        }


def pooled(table: Any) -> list[dict[str, Any]]:
    """Return numbers for each cell; rows of a cell are together."""
    names = _grid_names(table)
    values = list(zip(*(table[name].to_pylist() for name in names), strict=True))
    values = values or [()] * len(table)
    out, begin = [], 0
    for k in range(1, len(values) + 1):
        if k == len(values) or values[k] != values[begin]:
            given = dict(zip(names, values[begin], strict=True))
            out.append(given | _pooled(table.slice(begin, k - begin)))
            begin = k
    return out


def _pooled(table: Any) -> dict[str, Any]:
    failures = [reason for reason in table["failure"].to_pylist() if reason is not None]
    out: dict[str, Any] = {"runs": len(table), "failed": len(failures)}
    out["first_failure"] = failures[0] if failures else None
    if "log" in table.column_names:
        for name in SUMS:
            out[name] = int(np.nansum(_numbers(table, name)))
        return out | {name: _mean(_numbers(table, name)) for name in POOLED_LOGS}
    for name in ERRORS:
        squares = [_mean(_numbers(table, f"{name}_{axis}") ** 2) for axis in "xyz"]
        out[name] = [None if s is None else s**0.5 for s in squares]
    return out | {name: _mean(_numbers(table, name)) for name in MEANS}


def _numbers(table: Any, name: str) -> Any:
    return np.array([np.nan if v is None else v for v in table[name].to_pylist()], dtype=float)


def _mean(values: Any) -> float | None:
    good = values[np.isfinite(values)]
    return float(good.mean()) if len(good) else None
