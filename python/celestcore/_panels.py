"""Panels of a report: series with bands over time, thinned so that a long log stays small.

A panel knows nothing of attitudes or orbits. `payload` is what `web/report.js` draws.
"""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from celestcore._curves import TimeAxis
from celestcore._epoch import read_epoch
from celestcore.solution import Array

BUCKETS = 600
"""A line keeps the lowest and the highest value of each of so many stretches of rows."""
DOTS = 2500
"""A cloud of dots keeps about so many, and its extremes."""
MOST_GAPS = 300
# Okabe and Ito's palette: told apart by people with any colour vision.
X, Y, Z, SPECIAL = "#0072B2", "#E69F00", "#009E73", "#D55E00"
INK, SKY = "#333333", "#56B4E9"
XYZ = ((X, "x"), (Y, "y"), (Z, "z"))
MORE = (X, Y, Z, "#CC79A7", SKY, "#8A6D00", INK)

Kind = Literal["line", "dash", "steps", "dots", "rings"]


@dataclass(frozen=True, eq=False)
class Series:
    """One column of a panel.

    Attributes
    ----------
    name, colour : str
    y : ndarray (n,)
        Values in the panel's unit; NaN breaks a line.
    half : ndarray (n,), optional
        Half the width of the band around it.
    kind : str
        ``line``, ``dash``, ``steps`` (level until the next row), ``dots`` or ``rings``.
    exact : ndarray (n,), optional
        What to tell if `y` was moved to the picture's edge.
    """

    name: str
    y: Array
    colour: str = X
    half: Array | None = None
    kind: Kind = "line"
    exact: Array | None = None


@dataclass(frozen=True, eq=False)
class Panel:
    """A plot: columns over common times.

    Attributes
    ----------
    title, unit : str
    t : ndarray (n,)
        Times [s], increasing.
    series : tuple of Series
    limits : (float, float), optional
        Of the vertical axis while all of the log is shown.
    log, zero : bool
        Whether the vertical axis is logarithmic; whether it begins at zero.
    bands : tuple of (float, float)
        Shaded in green: where values are expected.
    lines : tuple of float
        Thresholds.
    period : float, optional
        Wrap the values into half a period on either side of zero.
    note : str
        What bands and lines mean.
    row : str
        Panels of the same row stand side by side; one without has the page's width.
    """

    title: str
    unit: str
    t: Array
    series: tuple[Series, ...]
    limits: tuple[float, float] | None = None
    log: bool = False
    zero: bool = False
    bands: tuple[tuple[float, float], ...] = ()
    lines: tuple[float, ...] = ()
    period: float | None = None
    note: str = ""
    row: str = ""


@dataclass(frozen=True, eq=False)
class Section:
    """A heading, words and panels (or finished HTML) below it."""

    heading: str
    words: str
    panels: tuple[Panel, ...] = ()
    html: str = ""
    name: str = ""


@dataclass(frozen=True, eq=False)
class Times:
    """The common time axis: how seconds become places, where gaps are, when t = 0 was.

    `marks` are times [s] to be marked in every panel.
    """

    axis: TimeAxis
    first: float
    last: float
    epoch: str | None = None
    gaps: Array = field(default_factory=lambda: np.zeros((0, 2)))
    marks: tuple[float, ...] = ()

    def place(self, t: float) -> float:
        """Return where a time [s] is on the axis."""
        return (t - self.axis.start) / self.axis.scale

    def date(self, t: float) -> str:
        """Return the date of a time [s], to the second; nothing unless the epoch is UTC."""
        start = _milliseconds(self.epoch)
        if start is None:
            return ""
        found = np.datetime64(round(start / 1e3 + t), "s")
        return str(found).replace("T", " ")

    @property
    def unit(self) -> str:
        """The axis' unit."""
        return self.axis.label.rpartition("[")[2].rstrip("]")


def page_data(panels: Sequence[Panel], times: Times) -> dict[str, Any]:
    """Return what the page's script needs: the axis, the gaps and every panel."""
    gaps = longest(times.gaps)
    span = [times.place(t) for t in (times.first, times.last)]
    pad = 0.01 * (span[1] - span[0]) or 1.0
    return {
        "unit": times.unit,
        "start": times.axis.start,
        "scale": times.axis.scale,
        "epoch": _milliseconds(times.epoch),
        "span": [span[0] - pad, span[1] + pad],
        "gaps": times.axis(gaps).round(9).tolist(),
        "marks": [round(times.place(t), 9) for t in times.marks[:MOST_GAPS]],
        "panels": [payload(panel, times, gaps) for panel in panels],
    }


def longest(gaps: Array) -> Array:
    """Return the longest gaps, in order of time."""
    if len(gaps) <= MOST_GAPS:
        return gaps
    keep = np.argsort(gaps[:, 0] - gaps[:, 1], kind="stable")[:MOST_GAPS]
    return np.asarray(gaps[np.sort(keep)])


def _milliseconds(epoch: str | None) -> float | None:
    """Return a UTC epoch in ms since 1970, for the hover's clock; None for other scales."""
    if epoch is None:
        return None
    found = read_epoch(epoch)
    if found.scale != "UTC":
        return None
    return 1e3 * ((found.mjd - 40587) * 86400.0 + found.seconds - found.offset)


def payload(panel: Panel, times: Times, gaps: Array) -> dict[str, Any]:
    """Return a panel as the script takes it: thinned, broken at gaps, packed."""
    rows = kept_rows(panel)
    t = panel.t[rows]
    columns = [_cut(s.y, rows) for s in panel.series]
    if panel.period is not None:
        columns = [(y + panel.period / 2) % panel.period - panel.period / 2 for y in columns]
    extra = [(_cut(s.half, rows), _cut(s.exact, rows)) for s in panel.series]
    lines = np.array([s.kind in ("line", "dash") for s in panel.series], dtype=bool)
    at, source = _breaks(panel, t, columns, gaps, lines)
    where = np.argsort(np.concatenate([np.arange(len(t)), at - 0.5]), kind="stable")
    when = np.concatenate([t, 0.5 * (t[at - 1] + t[at]) if len(at) else t[:0]])[where]

    def packed(y: Array | None, nan: NDArray[np.bool_] | None = None) -> str | None:
        if y is None:
            return None
        between = y[at - 1].copy() if len(at) else y[:0]
        if nan is not None:
            between[nan] = np.nan
        return _pack(np.concatenate([y, between])[where].astype("<f4"))

    return {
        "unit": panel.unit,
        "log": panel.log,
        "zero": panel.zero,
        "wrapped": panel.period is not None and panel.limits is not None,
        "limits": None if panel.limits is None else [float(v) for v in panel.limits],
        "bands": [list(band) for band in panel.bands],
        "lines": list(panel.lines),
        "x": _pack(times.axis(when).astype("<f8")),
        "series": [
            {
                "name": s.name,
                "colour": s.colour,
                "kind": s.kind,
                "y": packed(y, source[k]),
                "half": packed(half),
                "exact": packed(exact),
            }
            for k, (s, y, (half, exact)) in enumerate(
                zip(panel.series, columns, extra, strict=True)
            )
        ],
    }


def _cut(y: Array | None, rows: NDArray[np.intp]) -> Any:
    return None if y is None else y[rows]


def _breaks(
    panel: Panel, t: Array, columns: list[Array], gaps: Array, lines: NDArray[np.bool_]
) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return before which rows to add one, and which series break there.

    Lines break in gaps and where wrapped values jump; what does not break goes on level.
    """
    n = len(t)
    cut = np.zeros((len(columns), max(n, 1)), dtype=bool)
    if n > 1 and len(gaps):
        row = np.searchsorted(t, 0.5 * (gaps[:, 0] + gaps[:, 1]))
        row = row[(row > 0) & (row < n)]
        cut[np.ix_(lines, row)] = True
    if panel.period is not None:
        for k, y in enumerate(columns):
            cut[k, 1:n] |= np.abs(np.diff(y)) > panel.period / 3.0
    at = np.flatnonzero(cut.any(axis=0))
    return at, cut[:, at]


def kept_rows(panel: Panel) -> NDArray[np.intp]:
    """Return the rows that show every series' extremes."""
    n = len(panel.t)
    parts: list[Any] = [[0, n - 1] if n else []]
    lines = sum(s.kind not in ("dots", "rings") for s in panel.series)
    for s in panel.series:
        if s.kind in ("dots", "rings"):
            parts.append(_dots(s.y))
        else:
            parts.append(extreme_rows(s.y, BUCKETS if lines <= 3 else 2 * BUCKETS // 3))
            if s.half is not None:
                parts.append(extreme_rows(s.half, BUCKETS // 3))
    return np.unique(np.concatenate([np.asarray(p, dtype=np.intp) for p in parts]))


def _dots(y: Array) -> NDArray[np.intp]:
    """Return evenly spaced ones of the rows that have a dot, and the extremes."""
    have = np.flatnonzero(np.isfinite(y))
    if len(have) <= DOTS:
        return have
    return np.union1d(have[:: -(-len(have) // DOTS)], have[extreme_rows(y[have], DOTS // 5)])


def extreme_rows(y: Array, buckets: int = BUCKETS) -> NDArray[np.intp]:
    """Return the rows with the lowest and highest value, and the first NaN, of each bucket.

    All rows, when there are few.

    Examples
    --------
    >>> extreme_rows(np.array([0.0, 5.0, -5.0, 0.0, 1.0, 1.0, 9.0, 1.0]), 2)
    array([1, 2, 4, 6])
    """
    n = len(y)
    if n <= 2 * buckets:
        return np.arange(n)
    size = -(-n // buckets)
    full = np.full(-(-n // size) * size, np.nan)
    full[:n] = y
    blocks = full.reshape(-1, size)
    start = size * np.arange(len(blocks))
    missing = np.isnan(blocks)
    low = np.where(missing, np.inf, blocks).argmin(axis=1)
    high = np.where(missing, -np.inf, blocks).argmax(axis=1)
    broken = missing.argmax(axis=1)[missing.any(axis=1)]
    rows = np.concatenate([start + low, start + high, start[missing.any(axis=1)] + broken])
    return np.asarray(np.unique(rows[rows < n]))


def _pack(column: NDArray[Any]) -> str:
    return base64.b64encode(column.tobytes()).decode("ascii")
