"""A replay's output read part by part, in bounded memory: what a report needs of it."""

from __future__ import annotations

import heapq
import json
import math
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._curves import euler_321
from celestcore._health import FIXES_A_WINDOW, HIGH, LEAST_REJECTED, LOW, REJECTING
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.replay._parts import TABLES
from celestcore.replay._tally import INNOVATION, SIGMA, Tally, Usual
from celestcore.replay._thin import Columns, Thinned
from celestcore.solution import Array

BATCH = 2**18
"""Rows that are in memory at once, whatever the length of a part."""
STRETCHES, PEAKS, DOTS = 1200, 200, 8000
"""Of the whole replay: stretches of rows and of measurements whose extremes are kept; dots."""
FEWEST_WINDOWS, MOST_WINDOWS = 60, 480
MOST_PARTS = 30


@dataclass(frozen=True)
class Odd:
    """A sensor in a part that stands out."""

    part: int
    begin: float
    end: float
    sensor: str
    fixes: int
    rejected: int
    nis_per_dof: float


@dataclass(eq=False)
class Digest:
    """What a replay has written, in short.

    Attributes
    ----------
    note : dict
        Version, filter, options, epoch and gate.
    summary : dict or None
        `summary.json`; None if the replay has not ended.
    edge : ndarray (parts + 1,)
        Where parts begin, and where the last ends [s].
    rows : dict of str to ndarray
        Rows to be drawn.
    even : dict of str to ndarray
        The last row of each batch.
    count : int
        All rows.
    tallies : list of Tally
    gaps : ndarray (k, 2)
        Of the gyro [s].
    restarts : list of float
    odd : list of Odd
        The parts that stand out most, in order of time; `odd_in_all` is how many there are.
    """

    note: dict[str, Any]
    summary: dict[str, Any] | None
    edge: Array
    rows: Columns
    even: Columns
    count: int
    tallies: list[Tally]
    gaps: Array
    restarts: list[float]
    odd: list[Odd] = field(default_factory=list)
    odd_in_all: int = 0


def digest(folder: str | os.PathLike[str]) -> Digest:
    """Read a replay's output, as far as it is complete.

    Raises
    ------
    InputError
        If there is no output, or no complete part.
    MissingDependencyError
        Without pyarrow.
    """
    return _Reader(Path(folder)).read()


class _Reader:
    def __init__(self, root: Path) -> None:
        self._parquet = require("pyarrow.parquet", extra="parquet", what="reading a replay's parts")
        self.root = root
        found = {table: self._numbers(table) for table in TABLES}
        if not found["rows"] or not found["health"]:
            raise InputError(
                "holds no replay in parts: give the folder that replay.run or celestcore replay "
                "--parts has written to",
                field="folder",
                value=os.fspath(root),
            )
        self.tables = [table for table, numbers in found.items() if numbers]
        # a replay that was stopped between the tables of a part has written only some of them
        self.parts = sorted(set.intersection(*(found[table] for table in self.tables)))
        if not self.parts:
            raise InputError(
                "has no part that is complete: let the replay go on first",
                field="folder",
                value=os.fspath(root),
            )
        with self._open("rows", self.parts[0]) as file:
            if "bx" not in file.schema_arrow.names:
                raise InputError(
                    "is of a log with GNSS fixes, of which only celestcore replay LOG --report and "
                    "solution.report make a page",
                    field="folder",
                    value=os.fspath(root),
                )

    def _numbers(self, table: str) -> set[int]:
        found = (self.root / table).glob("part-*.parquet")
        return {int(path.stem.removeprefix("part-")) for path in found}

    def _open(self, table: str, part: int) -> Any:
        path = self.root / table / f"part-{part:06d}.parquet"
        coded = ["sensor"] if table == "measurements" else None
        return self._parquet.ParquetFile(path, read_dictionary=coded)

    def _batches(self, table: str, part: int, names: tuple[str, ...] = ()) -> Iterator[Any]:
        if table not in self.tables:
            return
        with self._open(table, part) as file:
            known = [name for name in names if name in file.schema_arrow.names] or None
            yield from file.iter_batches(BATCH, columns=known)

    def read(self) -> Digest:
        note, edge, batches, count = self._survey()
        usual = self._usual()
        windows = window_edges(edge, sum(u[1] for u in usual.values()) / max(len(usual), 1))
        rate = (-(-PEAKS // batches), -(-DOTS // batches))
        tallies = {name: Tally(name, usual[name][0], windows, *rate) for name in sorted(usual)}
        rows = Thinned(_drawn_values, -(-STRETCHES // batches))
        even = Thinned(lambda _: [], 1)
        gaps: list[Array] = []
        restarts: list[float] = []
        odd = _Odds()
        for part in self.parts:
            for batch in self._batches("rows", part):
                columns = {n: batch.column(n).to_numpy() for n in batch.schema.names}
                rows.add(columns)
                even.add({name: column[-1:] for name, column in columns.items()})
            self._measurements(part, tallies)
            self._events(part, gaps, restarts)
            self._health(part, tallies, odd)
        file = self.root / "summary.json"
        summary = json.loads(file.read_text(encoding="utf-8")) if file.exists() else None
        return Digest(
            note=note,
            summary=summary,
            edge=edge,
            rows=rows.columns(),
            even=even.columns(),
            count=count,
            tallies=[t for t in tallies.values() if t.fixes],
            gaps=np.concatenate([np.zeros((0, 2)), *gaps]),
            restarts=restarts,
            odd=odd.found(),
            odd_in_all=odd.count,
        )

    def _survey(self) -> tuple[dict[str, Any], Array, int, int]:
        """Return the replay's note, where parts begin, how many batches and rows there are."""
        note: dict[str, Any] = {}
        edge: list[float] = []
        batches = count = 0
        last = math.nan
        for part in self.parts:
            with self._open("rows", part) as file:
                rows = file.metadata.num_rows
                note = json.loads((file.metadata.metadata or {}).get(b"celestcore", b"{}"))
                if not rows:
                    continue
                t = file.schema_arrow.names.index("t")
                groups = [file.metadata.row_group(g) for g in range(file.num_row_groups)]
                found = [group.column(t).statistics for group in groups if group.num_rows]
                edge.append(float(found[0].min))
                last = float(found[-1].max)
                batches += -(-rows // BATCH)
                count += rows
        if not edge:
            raise InputError(
                "has no rows yet: let the replay go on first",
                field="folder",
                value=os.fspath(self.root),
            )
        return note, np.array([*edge, max(last, np.nextafter(edge[-1], np.inf))]), batches, count

    def _usual(self) -> dict[str, tuple[Usual, int]]:
        """Return what is usual of each sensor, and how many measurements it has."""
        names = ("t", "sensor", "dof", "accepted", *SIGMA)
        seen: dict[str, list[tuple[Array | None, float]]] = {}
        dof: dict[str, int] = {}
        many: dict[str, int] = {}
        for part in self.parts:
            for batch in self._batches("measurements", part, names):
                for name, columns in _by_sensor(batch):
                    mine = seen.setdefault(name, [])
                    dof.setdefault(name, int(columns["dof"][0]))
                    many[name] = many.get(name, 0) + len(columns["t"])
                    good = columns["accepted"]
                    if good.sum() < 3:
                        continue
                    full = SIGMA[: dof[name]]
                    sigma = (
                        np.array([np.median(columns[n][good]) for n in full])
                        if full[0] in columns
                        else None
                    )
                    mine.append((sigma, float(np.median(np.diff(columns["t"])))))
        return {name: (_middle(dof[name], mine), many[name]) for name, mine in seen.items()}

    def _measurements(self, part: int, tallies: dict[str, Tally]) -> None:
        names = ("t", "sensor", "nis", "accepted", *INNOVATION, *SIGMA)
        for batch in self._batches("measurements", part, names):
            for name, columns in _by_sensor(batch):
                tallies[name].add(columns)

    def _events(self, part: int, gaps: list[Array], restarts: list[float]) -> None:
        for batch in self._batches("events", part):
            t, end = (batch.column(n).to_numpy() for n in ("t", "t_end"))
            gap = np.array([kind == "gap" for kind in batch.column("kind").to_pylist()], dtype=bool)
            gaps.append(np.column_stack([t[gap], end[gap]]))
            restarts += t[~gap].tolist()

    def _health(self, part: int, tallies: dict[str, Tally], odd: _Odds) -> None:
        for batch in self._batches("health", part):
            every = batch.to_pylist()
            odd.add(part, every)
            for row in every:
                if row["sensor"] in tallies and "sx" in row:
                    sigma = np.array([row[n] for n in ("sx", "sy", "sz")])
                    scale = row.get("noise_scale")  # not in parts of earlier versions
                    tallies[row["sensor"]].tell(sigma, row["fixes"], scale)


class _Odds:
    """The parts that stand out most."""

    def __init__(self) -> None:
        self.count = 0
        self._kept: list[tuple[float, int, Odd]] = []

    def add(self, part: int, rows: list[dict[str, Any]]) -> None:
        """Judge a part's rows: several of a sensor if the filter started again in it."""
        for name in sorted({row["sensor"] for row in rows}):
            mine = [row for row in rows if row["sensor"] == name and row["fixes"]]
            if mine:
                self._judge(part, name, mine)

    def _judge(self, part: int, name: str, rows: list[dict[str, Any]]) -> None:
        fixes, rejected = (sum(row[key] for row in rows) for key in ("fixes", "rejected"))
        nis = sum(row["nis_per_dof"] * row["fixes"] for row in rows) / fixes
        share = rejected / fixes if fixes else 0.0
        many = rejected >= LEAST_REJECTED and share > REJECTING
        # of all measurements of a part, refused ones too: see `celestcore.replay._filter.health`
        off = fixes >= FIXES_A_WINDOW and not LOW <= nis <= HIGH
        if not (many or off):
            return
        self.count += 1
        size = share + abs(math.log(nis)) if nis > 0.0 and math.isfinite(nis) else share
        begin, end = min(row["t"] for row in rows), max(row["t_end"] for row in rows)
        one = Odd(part, begin, end, name, fixes, rejected, nis)
        keep = heapq.heappush if len(self._kept) < MOST_PARTS else heapq.heappushpop
        keep(self._kept, (size, -self.count, one))

    def found(self) -> list[Odd]:
        return sorted((one for *_, one in self._kept), key=lambda o: (o.begin, o.sensor))


def _by_sensor(batch: Any) -> Iterator[tuple[str, Columns]]:
    """Yield each sensor's rows of a batch."""
    sensor = batch.column("sensor")
    names, which = sensor.dictionary.to_pylist(), sensor.indices.to_numpy()
    columns = {
        n: batch.column(n).to_numpy(zero_copy_only=False)
        for n in batch.schema.names
        if n != "sensor"
    }
    for k, name in enumerate(names):
        rows = which == k
        if rows.any():
            yield name, {n: column[rows] for n, column in columns.items()}


def _middle(dof: int, seen: list[tuple[Array | None, float]]) -> Usual:
    """Return the medians of the medians of parts: one part that is odd does not count."""
    sigmas = [sigma for sigma, _ in seen if sigma is not None]
    step = float(np.median([step for _, step in seen])) if seen else math.nan
    return Usual(dof, np.median(sigmas, axis=0) if sigmas else None, step)


def _drawn_values(columns: Columns) -> list[Array]:
    """Return the columns of rows whose extremes are drawn."""
    q = np.stack([columns[n] for n in ("qw", "qx", "qy", "qz")], axis=1)
    names = [n for n in columns if n[0] in "wb" or n.startswith("s_")]
    return [*(columns[n] for n in names), *euler_321(q).T]


def window_edges(edge: Array, fixes: float) -> Array:
    """Return where windows of the health timeline begin: parts, several together, or shares of one.

    Parameters
    ----------
    edge : ndarray (parts + 1,)
        Where parts begin [s].
    fixes : float
        Measurements of a sensor.
    """
    parts = len(edge) - 1
    if parts > MOST_WINDOWS:
        step = -(-parts // MOST_WINDOWS)
        return np.unique(np.append(edge[:-1:step], edge[-1]))
    wanted = int(np.clip(fixes // FIXES_A_WINDOW, 1, FEWEST_WINDOWS))
    share = max(-(-wanted // parts), 1)
    at = np.arange(parts * share + 1) / share
    return np.unique(np.interp(at, np.arange(parts + 1.0), edge))
