"""Sections of a report that every navigator has: innovations, NIS, the sensors' health."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from celestcore._fixes import Fixes
from celestcore._health import HIGH, LOW, REJECTING, RULES, windows
from celestcore._panels import INK, MORE, SKY, SPECIAL, Panel, Section, Series, X
from celestcore.solution import Array
from celestcore.summary import chi2_bounds, inside_95

INNOVATIONS = (
    "Each dot is a measurement minus what the filter had predicted just before. Blue band: ±3 "
    "sigma as predicted; 99.7 % of the dots should lie in it. A drift or a wave means that the "
    "noise is not white. Rings are measurements the gate rejected; those beyond the scale are "
    "drawn at its edge."
)
NIS = (
    "The normalised innovation squared (NIS) is the square of the innovation measured in its own "
    "predicted sigmas. If the error bars are right it averages the number of degrees of freedom "
    "and 95 % of the dots lie in the green band (chi-square). Dots that sit high mean error bars "
    "too small; dots that sit low mean error bars too large. Fixes that were smoothed on board "
    "have errors that hang together from one to the next: then the dots sit low, and this test "
    "does not tell how good the error bars are over minutes."
)
NIS_HEADING = "Are the error bars right?"


def innovations(fixes: Sequence[Fixes]) -> Section:
    """Return the innovations, one panel an axis of each sensor."""
    panels = [
        _innovation(each, k)
        for each in fixes
        if each.innovation is not None
        for k in range(len(each.axes))
    ]
    return Section("Innovations", INNOVATIONS, tuple(panels), name="innovation")


def _innovation(fixes: Fixes, k: int) -> Panel:
    assert fixes.innovation is not None
    assert fixes.sigma is not None
    value, band, used = fixes.innovation[:, k], 3.0 * fixes.sigma[:, k], fixes.accepted
    inside = np.abs(value[used]) <= band[used]
    share = _percent(inside) if fixes.whole is None else _spelt(fixes.whole.inside_3[k])
    known = band[np.isfinite(band)]
    limit = 1.25 * max(_percentile(known, 98), _largest(np.abs(value[used]))) or 1.0
    series = [
        Series("±3 sigma predicted", np.zeros(len(value)), SKY, half=band),
        Series("used", np.where(used, value, np.nan), X, kind="dots"),
        *_rejected(fixes, value, -0.96 * limit, 0.96 * limit),
    ]
    return Panel(
        title=f"{fixes.name}, {fixes.axes[k]}: {share} in ±3 sigma",
        unit=fixes.unit,
        t=fixes.t,
        series=tuple(series),
        limits=(-limit, limit),
        row=fixes.name,
    )


def _rejected(fixes: Fixes, value: Array, low: float, high: float) -> list[Series]:
    """Return the rejected ones as rings, at the picture's edge if they lie beyond it."""
    rejected = int((~fixes.accepted).sum()) if fixes.whole is None else fixes.whole.rejected
    if rejected == 0:
        return []
    mine = np.where(fixes.accepted, np.nan, value)
    shown = np.clip(mine, low, high)
    return [Series(f"rejected ({rejected:,})", shown, SPECIAL, kind="rings", exact=mine)]


def nis(fixes: Sequence[Fixes]) -> Section:
    """Return the NIS, one panel a sensor, with chi-square bounds and the running mean."""
    return Section(NIS_HEADING, NIS, tuple(_nis(each) for each in fixes), name="nis")


def _nis(fixes: Fixes) -> Panel:
    used = fixes.used
    low, high = chi2_bounds(fixes.dof)
    nis = fixes.nis[used]
    inside = inside_95(nis, np.full(len(nis), fixes.dof))
    share = _percent(inside) if fixes.whole is None else _spelt(fixes.whole.inside_95)
    bottom = 10.0 ** math.floor(math.log10(low / 10.0))
    top = 4.0 * max(high, _largest(nis))
    shown = np.where(used, np.maximum(fixes.nis, 1.05 * bottom), np.nan)
    series = [Series("used", shown, X, kind="dots", exact=np.where(used, fixes.nis, np.nan))]
    if fixes.whole is not None:  # a mean over what is drawn would be one of its extremes
        seen = fixes.whole.windows
        row = np.clip(np.searchsorted(seen.edge, fixes.t, side="right") - 1, 0, len(seen.ratio) - 1)
        mean = fixes.dof * seen.ratio[row]
        series.append(Series("mean of a window", mean, INK, kind="dash"))
    elif len(nis) >= 50:
        window = max(25, len(nis) // 60)
        running = np.full(len(fixes.t), np.nan)
        total = np.cumsum(np.concatenate([[0.0], nis]))
        middle = np.flatnonzero(used)[(window - 1) // 2 :][: len(nis) - window + 1]
        running[middle] = (total[window:] - total[:-window]) / window
        series.append(Series(f"mean of {window}", running, INK, kind="dash"))
    series += _rejected(fixes, fixes.nis, 1.2 * bottom, top / 1.2)
    return Panel(
        title=f"{fixes.name} (should average {fixes.dof}): {share} in 95 % bounds",
        unit="",
        t=fixes.t,
        series=tuple(series),
        limits=(bottom, top),
        log=True,
        bands=((low, high),),
    )


def health(fixes: Sequence[Fixes], first: float, last: float, html: str) -> Section:
    """Return the timeline (finished HTML), running NIS and rejections over windows."""
    seen = [windows(each, first, last) for each in fixes]
    lanes = list(zip(fixes, seen, strict=True))
    if not lanes:
        return Section("How the sensors fared", "No measurements were kept.", name="health")
    colours = [MORE[k % len(MORE)] for k in range(len(lanes))]
    edges = np.unique(np.concatenate([w.edge for w in seen]))

    def column(edge: Array, value: Array) -> Array:
        row = np.clip(np.searchsorted(edge, edges, side="right") - 1, 0, len(value) - 1)
        return np.asarray(value[row])

    ratio = [
        Series(f.name, column(w.edge, np.maximum(w.ratio, 1e-3)), c, kind="steps")
        for (f, w), c in zip(lanes, colours, strict=True)
    ]
    share = [
        Series(f.name, column(w.edge, w.share), c, kind="steps")
        for (f, w), c in zip(lanes, colours, strict=True)
    ]
    panels = (
        Panel(
            "Running NIS per degree of freedom (ideal 1)",
            "",
            edges,
            tuple(ratio),
            log=True,
            limits=_around(ratio),
            lines=(LOW, HIGH),
            note=f"Dashed: thresholds {LOW:g} and {HIGH:g}.",
        ),
        Panel(
            "Rejected measurements",
            "%",
            edges,
            tuple(share),
            zero=True,
            limits=(0.0, max(15.0, 1.1 * max(_largest(s.y) for s in share))),
            lines=(100.0 * REJECTING,),
            note=f"Dashed: threshold {100 * REJECTING:g} %.",
        ),
    )
    return Section("How the sensors fared", RULES, panels, html=html, name="health")


def _around(series: Sequence[Series]) -> tuple[float, float]:
    """Return limits around all values and the thresholds."""
    values = np.concatenate([s.y for s in series])
    values = values[np.isfinite(values)]
    low, high = (float(v) for v in (values.min(), values.max())) if len(values) else (1.0, 1.0)
    return 0.7 * min(low, LOW), 1.4 * max(high, HIGH)


def _largest(value: Array) -> float:
    value = value[np.isfinite(value)]
    return float(value.max()) if len(value) else 0.0


def _percentile(value: Array, q: float) -> float:
    return float(np.percentile(value, q)) if len(value) else 0.0


def _percent(inside: NDArray[np.bool_]) -> str:
    return _spelt(float(np.mean(inside)) if len(inside) else math.nan)


def _spelt(share: float) -> str:
    return f"{100.0 * share:.1f} %" if math.isfinite(share) else "none"
