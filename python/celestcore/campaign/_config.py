"""A campaign as its file describes it, checked before anything runs."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from celestcore._arguments import count
from celestcore._toml import load_toml
from celestcore.campaign import _logs, _simulated
from celestcore.campaign._grid import Grid, canonical, label, overlaid
from celestcore.campaign._schema import CAMPAIGN, SCORED, Tables, checked, table
from celestcore.errors import InputError
from celestcore.simulate._scenario import whole

TRIALS = 100
TRIES = 3
MOST_RUNS = 10**8
"""Runs beyond which their number is taken for a mistake."""


@dataclass(frozen=True, eq=False)
class Cell:
    """One point of the grid.

    Attributes
    ----------
    values : dict
        The grid's settings here, as in the file.
    text : str
        All settings that its results depend on, in SI units, as one text.

    Examples
    --------
    >>> import celestcore as cc
    >>> table = {"scenario": {"duration_s": 60}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
    >>> cc.campaign.Campaign.from_dict({**table, "campaign": {"trials": 2}}).cells[0].values
    {}
    """

    values: Mapping[str, Any]
    text: str

    def key(self, run: str) -> str:
        """Return what a run of this cell is known by, whatever else the campaign runs.

        Parameters
        ----------
        run : str
            The trial's number, or a digest of the log.

        Examples
        --------
        >>> len(Cell({}, "settings").key("0"))
        32
        """
        return hashlib.sha256(f"{self.text}\0{run}".encode()).hexdigest()[:32]


@dataclass(frozen=True, eq=False)
class Campaign:
    """What is to be run: cells of a grid times trials, or times logs.

    Attributes
    ----------
    document : dict
        The tables as they were given.
    cells : tuple of Cell
        Points of the grid, one if there is none.
    first, trials : int
        Numbers of the trials in each cell; of a campaign over logs, none.
    logs : dict of str to Path
        The logs by name; of a simulated campaign, none.
    tries : int
        How often a run is tried that takes its worker with it.
    batch : int or None
        Trials in one task at most.

    Examples
    --------
    >>> import celestcore as cc
    >>> campaign = cc.campaign.Campaign.from_dict({
    ...     "campaign": {"trials": 5},
    ...     "scenario": {"duration_s": 60},
    ...     "gyro": {"arw": 1e-6},
    ...     "star": {"sigma_arcsec": 5},
    ...     "grid": {"filter.kind": ["ekf", "ukf"]},
    ... })
    >>> campaign, len(campaign)
    (Campaign(2 cells, 5 trials each), 10)
    """

    document: Mapping[str, Any]
    cells: tuple[Cell, ...]
    first: int
    trials: int
    logs: Mapping[str, Path]
    tries: int = TRIES
    batch: int | None = None

    def __len__(self) -> int:
        """Return the number of runs."""
        return len(self.cells) * (len(self.logs) if self.logs else self.trials)

    def __repr__(self) -> str:
        cells = f"{len(self.cells)} cell{'s' if len(self.cells) > 1 else ''}"
        what = f"{len(self.logs)} logs" if self.logs else f"{self.trials} trials"
        return f"Campaign({cells}, {what} each)"

    @property
    def grid(self) -> dict[str, list[Any]]:
        """The grid's settings, each with its values.

        Examples
        --------
        >>> Campaign({}, (Cell({}, ""),), 0, 1, {}).grid
        {}
        """
        out: dict[str, list[Any]] = {}
        for cell in self.cells:
            for name, value in cell.values.items():
                out.setdefault(name, []).append(value)
        return out

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Campaign:
        r"""Read and check a TOML file; a folder of logs is looked for beside it.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Campaign

        Raises
        ------
        InputError
            Names the file, the key and the value.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder, "c.toml")
        ...     text = "scenario.duration_s = 60\ngyro.arw = 1e-6\nstar.sigma = 1e-5"
        ...     _ = file.write_text(text)
        ...     Campaign.from_toml(file)
        Campaign(1 cell, 100 trials each)
        """
        document = load_toml(path)
        try:
            return cls.from_dict(document, folder=Path(path).parent)
        except InputError as error:
            raise (error if error.source else error.located(os.fspath(path))) from None

    @classmethod
    def from_dict(
        cls, document: Mapping[str, Any], *, folder: str | os.PathLike[str] = "."
    ) -> Campaign:
        """Check a campaign given as a mapping of tables.

        Parameters
        ----------
        document : mapping of str to mapping
            Tables and their keys, as in the file.
        folder : path
            Where a relative folder of logs is looked for.

        Returns
        -------
        Campaign

        Raises
        ------
        InputError
            Names the key and the value, and for a cell of the grid its settings.

        Examples
        --------
        >>> flown = {"scenario": {"duration_s": 60}, "gyro": {"arw": 1e-6}, "star": {"sigma": 1e-5}}
        >>> Campaign.from_dict({**flown, "grid": {"star.period_s": [0.5, 1.0, 2.0]}})
        Campaign(3 cells, 100 trials each)
        """
        tables = {str(name): table(str(name), values) for name, values in document.items()}
        if "logs" not in tables and "scenario" not in tables:
            raise InputError("needs a table [scenario] to simulate, or [logs] to replay")
        simulated = "logs" not in tables
        options = checked("campaign", tables.get("campaign", {}), CAMPAIGN if simulated else SCORED)
        grid = Grid.read(tables["grid"]) if "grid" in tables else Grid({})
        cells = tuple(_cell(tables, values, simulated) for values in grid.cells())
        _distinct(cells)
        made = cls(
            document=tables,
            cells=cells,
            first=whole(options.get("first", 0), "campaign.first", 56),
            trials=count(options.get("trials", TRIALS), "campaign.trials") if simulated else 0,
            logs={} if simulated else _logs.found(tables["logs"], Path(folder)),
            tries=count(options.get("tries", TRIES), "campaign.tries"),
            batch=count(options["batch"], "campaign.batch") if "batch" in options else None,
        )
        if made.first + made.trials > 2**56:
            raise InputError("trials are counted to 2**56 - 1", field="campaign.first")
        if len(made) > MOST_RUNS:
            words = f"makes {len(made):,} runs; {MOST_RUNS:,} are possible"
            raise InputError(words, field="campaign.trials")
        return made


def _cell(tables: Tables, values: Mapping[str, Any], simulated: bool) -> Cell:
    """Check one cell, also what only shows when its scenario is built."""
    try:
        document = overlaid(tables, values)
        if not simulated:
            return Cell(values, canonical(_logs.settings_of(document)))
        text = canonical(_simulated.settings_of(document))
        _simulated.job_of(text)
        return Cell(values, text)
    except InputError as error:
        if values:
            error.message += f" (in the cell {label(values)})"
        raise


def _distinct(cells: tuple[Cell, ...]) -> None:
    seen: dict[str, Cell] = {}
    for cell in cells:
        same = seen.setdefault(cell.text, cell)
        if same is not cell:
            words = f"two cells are the same: {label(same.values)}; {label(cell.values)}"
            raise InputError(words, field="grid")
