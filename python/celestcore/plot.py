"""Pictures of a solution (matplotlib, no display needed, no global state)."""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore._curves import BINS, TimeAxis, euler_321, extremes, settled, time_axis, wrapped
from celestcore._files import replacing
from celestcore._optional import require
from celestcore.errors import InputError
from celestcore.solution import Array
from celestcore.summary import chi2_bounds, inside_95
from celestcore.units import ARCSEC, DEG, DEG_PER_HOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import GridSpec

    from celestcore.analysis import WithheldDrift
    from celestcore.solution import Solution

PANELS = ("attitude", "bias", "sigma", "innovation", "nis")
NEEDS = {"innovation": "full", "nis": "nis"}
"""What a run must have kept of the measurements for a panel: its option ``innovations``."""
# Okabe and Ito's palette: told apart by people with any colour vision.
X, Y, Z, REJECTED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
AXES_COLOURS = ((X, "x"), (Y, "y"), (Z, "z"))
INK, GRID, SHADE = "#333333", "#E3E3E3", "#BBBBBB"
DOTS = 2500  # a cloud is drawn with about this many dots


def figure(solution: Solution, panels: tuple[str, ...] = PANELS, *, width: float = 11.0) -> Figure:
    """Draw a solution.

    Parameters
    ----------
    solution : Solution
    panels : tuple of str
        Which of ``attitude`` (3-2-1 Euler angles, deg), ``bias`` (deg/h, with +-3 sigma),
        ``sigma`` (one-sigma attitude error, arcsec), ``innovation`` (arcsec, with +-3 sigma)
        and ``nis`` (with its 95 % chi-square bounds), in that order from the top.
    width : float
        Width in inches.

    Returns
    -------
    matplotlib.figure.Figure
        Long series are thinned: lines keep the lowest and highest value of each bin, clouds
        keep evenly spaced dots and a band from lowest to highest.

    Raises
    ------
    InputError
        If a panel is unknown or shows what was not kept, or the solution is empty.
    MissingDependencyError
        If matplotlib is not installed.
    """
    unknown = [name for name in panels if name not in PANELS]
    if unknown or not panels:
        raise InputError(
            f"unknown panel {unknown}: choose from {', '.join(PANELS)}", field="panels"
        )
    if len(solution) == 0:
        raise InputError("the solution is empty: there is nothing to plot", field="t")
    for name in panels:
        if name in NEEDS:
            solution._need(NEEDS[name], f"the panel {name!r}")
    rows = [row for name in panels for row in _rows(solution, name)]
    heights = [2.3 if name == "attitude" else 2.1 for name, _ in rows]
    fig = _new_figure(width, sum(heights) + 0.7)
    grid = fig.add_gridspec(len(rows), 3, height_ratios=heights)
    time = time_axis(solution.t, solution.epoch)
    for k, (name, sensor) in enumerate(rows):
        axes = _DRAW[name](solution, sensor, time, fig, grid, k)
        for ax in axes:
            _finish(ax, solution, time, wide=len(axes) == 1, label=k == len(rows) - 1)
    if len(panels) > 1:
        fig.suptitle(_title(solution), x=0.01, ha="left", fontsize=13, weight="bold", color=INK)
    return fig


def drift_figure(drift: WithheldDrift, epoch: str | None = None, *, width: float = 11.0) -> Figure:
    """Draw how far predictions drifted in windows without fixes, one mark a window.

    Parameters
    ----------
    drift : WithheldDrift
        From `celestcore.analysis.withheld_drift`.
    epoch : str, optional
        Epoch of the log, for the time axis.
    width : float
        Width in inches.
    """
    fig = _new_figure(width, 2.9)
    ax = fig.add_subplot()
    time = time_axis(drift.start, epoch)
    t = time(drift.start + 0.5 * drift.window)
    ax.plot(t, 3.0 * drift.sigma / ARCSEC, "_", color=INK, ms=9, mew=1.5, label="3 sigma predicted")
    plain, drifted = drift.drift_without_bias / ARCSEC, drift.drift / ARCSEC
    ax.plot(t, plain, "o", mfc="none", mec=Y, ms=5, label="plain integration of the rates")
    ax.plot(t, drifted, "o", color=X, ms=5, label="filter's prediction")
    ax.set_title(f"Drift after {drift.window:g} s without fixes")
    ax.set_ylabel("drift [arcsec]")
    _log_scale(ax)
    _style(ax)
    _key(ax)
    ax.set_xlabel(time.label, fontsize=9, color=INK)
    return fig


def save(fig: Figure, path: str | os.PathLike[str], *, dpi: int = 130) -> None:
    """Write a figure; the file appears whole or not at all.

    Raises
    ------
    InputError
        If the directory does not exist.
    """
    kind = os.fspath(path).rpartition(".")[2].lower() or "png"
    with replacing(path) as temporary:
        fig.savefig(temporary, format=kind, dpi=dpi)


def kept(solution: Solution) -> tuple[str, ...]:
    """Return the panels that show what the solution has kept."""
    lost = {"full": (), "nis": ("innovation",)}.get(solution.innovations, tuple(NEEDS))
    return tuple(name for name in PANELS if name not in lost)


def _rows(solution: Solution, panel: str) -> list[tuple[str, int]]:
    """Return one row a panel, or one a sensor for what belongs to a sensor."""
    if panel in ("innovation", "nis"):
        seen = [int(k) for k in np.unique(solution.sensor)]
        return [(panel, k) for k in seen] or [(panel, -1)]
    return [(panel, -1)]


def _attitude(
    solution: Solution, sensor: int, time: TimeAxis, fig: Figure, grid: GridSpec, row: int
) -> list[Axes]:
    ax = fig.add_subplot(grid[row, :])
    names = ("yaw", "pitch", "roll")
    inertial = solution.frames.get("inertial", "the inertial frame")
    for angle, (colour, _), name in zip(
        euler_321(solution.q).T / DEG, AXES_COLOURS, names, strict=True
    ):
        turned = np.unwrap(angle, period=360.0) if name != "pitch" else angle
        keep = extremes(turned)
        t, value = wrapped(time(solution.t[keep]), turned[keep])
        ax.plot(t, value, color=colour, lw=1.1, label=name)
    ax.set_title(f"Attitude: 3-2-1 Euler angles (yaw, pitch, roll), body relative to {inertial}")
    ax.set_ylabel("angle [deg]")
    ax.set_ylim(-190, 190)
    ax.set_yticks([-180, -90, 0, 90, 180])
    return [ax]


def _bias(
    solution: Solution, sensor: int, time: TimeAxis, fig: Figure, grid: GridSpec, row: int
) -> list[Axes]:
    out = []
    for k, (colour, name) in enumerate(AXES_COLOURS):
        ax = fig.add_subplot(grid[row, k])
        value = solution.bias[:, k] / DEG_PER_HOUR
        band = 3.0 * solution.sigma[:, 3 + k] / DEG_PER_HOUR
        low, high = extremes(value - band), extremes(value + band)
        rows = np.union1d(low, high)
        t = time(solution.t[rows])
        ax.fill_between(
            t, (value - band)[rows], (value + band)[rows], color=colour, alpha=0.2, lw=0
        )
        keep = extremes(value)
        ax.plot(time(solution.t[keep]), value[keep], color=colour, lw=1.1)
        ax.set_ylim(*settled(value - band, value + band))
        ax.set_title(f"Gyro bias {name} (band: ±3 sigma)")
        if k == 0:
            ax.set_ylabel("bias [deg/h]")
        out.append(ax)
    return out


def _sigma(
    solution: Solution, sensor: int, time: TimeAxis, fig: Figure, grid: GridSpec, row: int
) -> list[Axes]:
    ax = fig.add_subplot(grid[row, :])
    sigma = solution.sigma[:, :3] / ARCSEC
    for k, (colour, name) in enumerate(AXES_COLOURS):
        keep = extremes(sigma[:, k])
        ax.plot(time(solution.t[keep]), sigma[keep, k], color=colour, lw=1.0, label=f"body {name}")
    by = "smoother" if solution.smoothed else "filter"
    ax.set_title(f"Attitude error predicted by the {by} (1 sigma, about each body axis)")
    ax.set_ylabel("1 sigma [arcsec]")
    if sigma.max() > 30.0 * max(float(np.median(sigma)), 1e-12):
        _log_scale(ax)
    else:
        ax.set_ylim(0.0, 1.25 * float(sigma.max()) or 1.0)
    return [ax]


def _innovation(
    solution: Solution, sensor: int, time: TimeAxis, fig: Figure, grid: GridSpec, row: int
) -> list[Axes]:
    mine = solution.sensor == sensor
    directions = 2 if mine.any() and int(solution.dof[mine][0]) == 2 else 3
    axes = []
    for k in range(directions):
        ax = fig.add_subplot(grid[row, k])
        rows = np.flatnonzero(mine & np.isfinite(solution.innovation[:, k]))
        t = time(solution.measurement_t[rows])
        value = solution.innovation[rows, k] / ARCSEC
        band = 3.0 * solution.innovation_sigma[rows, k] / ARCSEC
        used = solution.accepted[rows]
        name = "xyz"[k] if directions == 3 else f"{k + 1}"
        inside = np.abs(value[used]) <= band[used]
        ax.set_title(
            f"Innovation, {_name(solution, sensor)} {name}: {_percent(inside)} in ±3 sigma"
        )
        if k == 0:
            ax.set_ylabel("innovation [arcsec]")
        if len(rows) == 0:
            _nothing(ax)
        else:
            limit = 1.25 * max(float(np.percentile(band, 98)), _top(np.abs(value[used])))
            _cloud(ax, t[used], value[used])
            for sign in (-1.0, 1.0):
                keep = extremes(band)
                ax.plot(t[keep], sign * band[keep], color=INK, lw=0.9, ls=(0, (4, 2)))
            _rejected(ax, t[~used], value[~used], -limit, limit)
            ax.set_ylim(-limit, limit)
        axes.append(ax)
    return axes


def _nis(
    solution: Solution, sensor: int, time: TimeAxis, fig: Figure, grid: GridSpec, row: int
) -> list[Axes]:
    ax = fig.add_subplot(grid[row, :])
    rows = np.flatnonzero((solution.sensor == sensor) & np.isfinite(solution.nis))
    ax.set_ylabel("NIS")
    if len(rows) == 0:
        ax.set_title("Normalised innovation squared (NIS)")
        _nothing(ax)
        return [ax]
    t, nis = time(solution.measurement_t[rows]), solution.nis[rows]
    used, dof = solution.accepted[rows], int(solution.dof[rows][0])
    low, high = chi2_bounds(dof)
    inside = inside_95(nis[used], solution.dof[rows][used])
    ax.set_title(
        f"NIS, {_name(solution, sensor)} (should average {dof}): {_percent(inside)} in 95 % bounds"
    )
    ax.axhspan(low, high, color=Z, alpha=0.13, lw=0, label="95 % chi-square bounds")
    _cloud(ax, t[used], nis[used])
    if used.sum() >= 50:
        window = max(25, int(used.sum()) // 60)
        total = np.cumsum(np.concatenate([[0.0], nis[used]]))
        smooth = (total[window:] - total[:-window]) / window
        middle = t[used][(window - 1) // 2 :][: len(smooth)]
        keep = extremes(smooth)
        ax.plot(middle[keep], smooth[keep], color=INK, lw=1.3, label=f"mean of {window} fixes")
    _log_scale(ax)
    bottom, top = low / 10.0, 4.0 * max(high, _top(nis[used]))
    _rejected(ax, t[~used], nis[~used], bottom, top)
    ax.set_ylim(bottom, top)
    return [ax]


def _cloud(ax: Axes, t: Array, value: Array) -> None:
    """Draw dots: all if few, else every so many and a band from lowest to highest."""
    step = max(1, -(-len(t) // DOTS))
    if step > 1:
        size = -(-len(t) // (BINS // 4))
        edge = np.arange(0, len(t), size)
        low, high = np.minimum.reduceat(value, edge), np.maximum.reduceat(value, edge)
        ax.fill_between(t[edge], low, high, color=X, alpha=0.12, lw=0)
    ax.plot(t[::step], value[::step], ".", color=X, ms=3, alpha=0.6, mew=0, rasterized=True)


def _rejected(ax: Axes, t: Array, value: Array, low: float, high: float) -> None:
    """Mark rejected fixes with crosses, at the edge of the picture if they lie beyond it."""
    if len(t) == 0:
        return
    keep = extremes(value, 200)
    size = 6.0 if len(keep) < 50 else 3.5
    linear = ax.get_yscale() == "linear"
    edge = 0.03 * (high - low)
    bottom, top = (low + edge, high - edge) if linear else (low * 1.25, high / 1.25)
    label = f"rejected ({len(t):,})"
    shown = np.clip(value[keep], bottom, top)
    ax.plot(t[keep], shown, "x", color=REJECTED, ms=size, mew=size / 4, label=label, zorder=5)


def _top(value: Array) -> float:
    return float(np.max(value)) if len(value) else 0.0


def _name(solution: Solution, sensor: int) -> str:
    known = 0 <= sensor < len(solution.sensor_names)
    return solution.sensor_names[sensor] if known else "no sensor"


def _title(solution: Solution) -> str:
    parts = [solution.title or "Attitude solution"]
    if solution.filter:
        parts.append(solution.filter.upper() + (", smoothed" if solution.smoothed else ""))
    return ", ".join(parts)


def _nothing(ax: Axes) -> None:
    ax.text(0.5, 0.5, "no fixes", transform=ax.transAxes, ha="center", color=INK)


def _percent(inside: NDArray[np.bool_]) -> str:
    return f"{100.0 * float(np.mean(inside)):.1f} %" if len(inside) else "none"


def _log_scale(ax: Axes) -> None:
    """Use a logarithmic scale with plain numbers at its ticks."""
    ax.set_yscale("log")
    ticker: Any = require("matplotlib.ticker", extra="plot", what="plotting")
    ax.yaxis.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(ticker.NullFormatter())


def _finish(ax: Axes, solution: Solution, time: TimeAxis, *, wide: bool, label: bool) -> None:
    """Give a panel its time axis, the shaded gaps and the common looks."""
    gaps = solution.gaps
    if len(gaps):
        begin, end = time(gaps[:, 0]), time(gaps[:, 1])
        ax.broken_barh(
            list(zip(begin.tolist(), (end - begin).tolist(), strict=True)),
            (0.0, 1.0),
            transform=ax.get_xaxis_transform(),
            facecolor=SHADE,
            edgecolor=SHADE,
            lw=0.6,
            alpha=0.45,
            zorder=0,
            label=f"gyro gap ({len(gaps):,})",
        )
    if wide:
        _key(ax)
    first, last = (float(time(solution.t[k])) for k in (0, -1))
    pad = 0.01 * (last - first) or 1.0
    ax.set_xlim(first - pad, last + pad)
    _style(ax)
    if label:
        ax.set_xlabel(time.label, fontsize=9, color=INK)


def _new_figure(width: float, height: float) -> Figure:
    figures: Any = require("matplotlib.figure", extra="plot", what="plotting")
    fig: Figure = figures.Figure(
        figsize=(width, height), dpi=110, layout="constrained", facecolor="white"
    )
    return fig


def _key(ax: Axes) -> None:
    """Put the legend above the panel, on the right."""
    if ax.get_legend_handles_labels()[1]:
        ax.legend(loc="lower right", bbox_to_anchor=(1.0, 0.98), ncols=6, fontsize=8, frameon=False)


def _style(ax: Axes) -> None:
    """Give a panel the common looks."""
    ax.set_title(ax.get_title(), fontsize=9.5, loc="left", color=INK)
    ax.set_title("", loc="center")
    ax.grid(color=GRID, lw=0.7)
    ax.set_axisbelow(True)
    ax.tick_params(labelsize=8, colors=INK)
    for side in ("top", "right"):
        ax.spines[side].set_visible(False)
    for side in ("left", "bottom"):
        ax.spines[side].set_color(SHADE)
    ax.yaxis.label.set_fontsize(9)


_DRAW = {
    "attitude": _attitude,
    "bias": _bias,
    "sigma": _sigma,
    "innovation": _innovation,
    "nis": _nis,
}
