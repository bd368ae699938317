"""Pictures of a replay with GNSS fixes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._curves import TimeAxis, extremes, time_axis
from celestcore.errors import InputError
from celestcore.plot import (
    AXES_COLOURS,
    INK,
    X,
    Z,
    _cloud,
    _key,
    _log_scale,
    _new_figure,
    _percent,
    _rejected,
    _style,
    _top,
    save,
)
from celestcore.summary import chi2_bounds
from celestcore.units import ARCSEC, DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from matplotlib.gridspec import SubplotSpec

    from celestcore._gnss_replay import GnssReplay
    from celestcore.gnss import GnssStarSolution, Innovations

UNITS = {"position": (1.0, "m"), "velocity": (1e-3, "mm/s")}
Draw = Callable[["GnssReplay | Drawn", TimeAxis, "Figure", "SubplotSpec"], "list[Axes]"]

__all__ = ["figure", "panels", "save"]


@dataclass(frozen=True, eq=False)
class Drawn:
    """A solution without tests of it, to be drawn."""

    solution: GnssStarSolution
    withheld: tuple[Any, ...] = ()
    pointing: Any = None


def panels(replay: GnssReplay | Drawn) -> tuple[str, ...]:
    """Return the names of the panels that there is something for."""
    sol = replay.solution
    kinds = [name for name in sol.counts if f"{name}_rejected" in sol.counts]
    innovations = [f"innovation {name}" for name in kinds]
    nis = [f"nis {name}" for name in kinds if name != "velocity"]
    withheld = [f"withheld {k}" for k in range(len(replay.withheld))]
    pointing = ["pointing"] if replay.pointing is not None else []
    return (*innovations, *nis, *withheld, *pointing, "sigma")


def figure(
    replay: GnssReplay | Drawn, names: tuple[str, ...] | None = None, *, width: float = 11.0
) -> Any:
    """Draw panels of a replay, one below the other.

    Parameters
    ----------
    replay : GnssReplay
    names : tuple of str, optional
        Some of `panels`; all.
    width : float
        Width in inches.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        If a panel is unknown.
    MissingDependencyError
        If matplotlib is not installed.
    """
    known = panels(replay)
    names = known if names is None else names
    for name in names:
        if name not in known:
            raise InputError(f"unknown panel {name}: choose from {', '.join(known)}")
    fig = _new_figure(width, 2.1 * len(names) + 0.7)
    grid = fig.add_gridspec(len(names), 1)
    sol = replay.solution
    time = time_axis(sol.t, sol.epoch)
    for k, name in enumerate(names):
        axes = _draw(name)(replay, time, fig, grid[k, 0])
        for ax in axes:
            _finish(ax, replay, time, wide=len(axes) == 1, label=k == len(names) - 1)
    return fig


def _draw(name: str) -> Draw:
    kind, _, what = name.partition(" ")
    if kind == "innovation":
        return lambda *given: _innovation(what, *given)
    if kind == "nis":
        return lambda *given: _nis(what, *given)
    if kind == "withheld":
        return lambda *given: _withheld(int(what), *given)
    return {"pointing": _pointing, "sigma": _sigma}[kind]


def _seen(replay: GnssReplay | Drawn, kind: str) -> tuple[Innovations, Any]:
    """Return innovations and which of them are of this kind."""
    seen = replay.solution.gnss if kind in UNITS else replay.solution.attitude
    return seen, np.flatnonzero(seen.kind == kind)


def _innovation(
    kind: str, replay: GnssReplay | Drawn, time: TimeAxis, fig: Figure, place: SubplotSpec
) -> list[Axes]:
    seen, rows = _seen(replay, kind)
    unit, name = UNITS.get(kind, (ARCSEC, "arcsec"))
    axes = []
    inner = place.subgridspec(1, 3)
    t, used = time(seen.t[rows]), seen.accepted[rows]
    for k, axis in enumerate("xyz"):
        ax = fig.add_subplot(inner[0, k])
        value = seen.innovation[rows, k] / unit
        band = 3.0 * seen.sigma[rows, k] / unit
        inside = np.abs(value[used]) <= band[used]
        ax.set_title(f"{kind} {axis}: {_percent(inside)} in ±3 sigma")
        if k == 0:
            ax.set_ylabel(f"innovation [{name}]")
        limit = 1.25 * max(float(np.percentile(band, 90)), _top(np.abs(value[used])))
        _cloud(ax, t[used], value[used])
        keep = extremes(band)
        for sign in (-1.0, 1.0):
            ax.plot(t[keep], sign * band[keep], color=INK, lw=0.9, ls=(0, (4, 2)))
        _rejected(ax, t[~used], value[~used], -limit, limit)
        ax.set_ylim(-limit, limit)
        axes.append(ax)
    return axes


def _nis(
    kind: str, replay: GnssReplay | Drawn, time: TimeAxis, fig: Figure, place: SubplotSpec
) -> list[Axes]:
    seen, rows = _seen(replay, kind)
    ax = fig.add_subplot(place)
    t, nis, used = time(seen.t[rows]), seen.nis[rows], seen.accepted[rows]
    low, high = chi2_bounds(3)
    inside = (nis[used] >= low) & (nis[used] <= high)
    mean = float(np.mean(nis[used])) if used.any() else np.nan
    ax.set_title(f"NIS, {kind}: mean {mean:.3g} (ideal 3), {_percent(inside)} in 95 % bounds")
    ax.set_ylabel("NIS")
    ax.axhspan(low, high, color=Z, alpha=0.13, lw=0, label="95 % chi-square bounds")
    _cloud(ax, t[used], nis[used])
    _log_scale(ax)
    bottom, top = low / 10.0, 4.0 * max(high, _top(nis[used]))
    _rejected(ax, t[~used], nis[~used], bottom, top)
    ax.set_ylim(bottom, top)
    return [ax]


def _withheld(
    k: int, replay: GnssReplay | Drawn, time: TimeAxis, fig: Figure, place: SubplotSpec
) -> list[Axes]:
    found = replay.withheld[k]
    ax = fig.add_subplot(place)
    t = time(found.start + 0.5 * found.window)
    ax.plot(t, 3.0 * found.sigma, "_", color=INK, ms=7, mew=1.4, label="3 sigma predicted")
    ax.plot(t, found.size, "o", color=X, ms=4, label="prediction less fix")
    ax.set_title(f"Position error after {found.window:g} s without fixes")
    ax.set_ylabel("error [m]")
    ax.set_ylim(0.0, 1.2 * max(3.0 * float(found.sigma.max()), _top(found.size)))
    return [ax]


def _pointing(
    replay: GnssReplay | Drawn, time: TimeAxis, fig: Figure, place: SubplotSpec
) -> list[Axes]:
    found = replay.pointing
    assert found is not None
    ax = fig.add_subplot(place)
    error = found.error / DEG
    for k, name in enumerate(("roll", "pitch", "yaw")):
        keep = extremes(error[:, k])
        colour = AXES_COLOURS[k][0]
        ax.plot(time(found.t[keep]), error[keep, k], color=colour, lw=0.8, label=name)
    ax.set_title("Attitude (star fixes) about the geodetic nadir of the GNSS fixes")
    ax.set_ylabel("angle [deg]")
    return [ax]


def _sigma(
    replay: GnssReplay | Drawn, time: TimeAxis, fig: Figure, place: SubplotSpec
) -> list[Axes]:
    sol = replay.solution
    ax = fig.add_subplot(place)
    for k, (colour, name) in enumerate(AXES_COLOURS):
        keep = extremes(sol.sigma_r[:, k])
        ax.plot(time(sol.t[keep]), sol.sigma_r[keep, k], color=colour, lw=1.0, label=name)
    by = "smoother" if sol.smoothed else "filter"
    ax.set_title(f"Position error predicted by the {by} (1 sigma, GCRS axes)")
    ax.set_ylabel("1 sigma [m]")
    if sol.sigma_r.max() > 30.0 * float(np.median(sol.sigma_r)):
        _log_scale(ax)
    else:
        ax.set_ylim(0.0, 1.25 * float(sol.sigma_r.max()))
    return [ax]


def _finish(
    ax: Axes, replay: GnssReplay | Drawn, time: TimeAxis, *, wide: bool, label: bool
) -> None:
    """Give a panel its time axis, the restarts and the common looks."""
    for k, t in enumerate(replay.solution.restarts):
        words = "orbit filter started again" if k == 0 and wide else None
        ax.axvline(float(time(np.array(t))), color=INK, lw=0.8, alpha=0.5, label=words)
    if wide:
        _key(ax)
    first, last = (float(time(replay.solution.t[k])) for k in (0, -1))
    pad = 0.01 * (last - first) or 1.0
    ax.set_xlim(first - pad, last + pad)
    _style(ax)
    if label:
        ax.set_xlabel(time.label, fontsize=9, color=INK)
