"""Pictures of analyses: what sensors must be like, Allan deviations, trades of orbit filters."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import plot
from celestcore._arguments import three
from celestcore._check import array, number
from celestcore._optional import require
from celestcore.analysis.requirements import AT, AXES, attained, judged, one_of
from celestcore.analysis.steady import Star, star_covariance
from celestcore.errors import InputError
from celestcore.units import ARCSEC, DEG_PER_HOUR, DEG_PER_SQRT_HOUR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celestcore.analysis.allan import AllanDeviation, AllanFit
    from celestcore.analysis.trade import Trade

Array = NDArray[np.float64]

_WORDS = {
    "filter": "just after a fix",
    "before": "just before a fix",
    "between": "at all gyro samples",
    "smoother": "smoothed",
}
_POINTS = 61


def plot_requirements(
    arw: ArrayLike,
    sigma: ArrayLike,
    gyro_dt: float,
    star_dt: float,
    *,
    target: float | None = None,
    rrw: float = 0.0,
    star: Star | None = None,
    rate: ArrayLike = (0.0, 0.0, 0.0),
    axis: str = "worst",
    level: float = 1.0,
    at: str = "filter",
    mark: Mapping[str, tuple[float, float]] | None = None,
    width: float = 8.0,
) -> Figure:
    """Draw the accuracy that gyros and star cameras reach together, as contours.

    Parameters
    ----------
    arw : array_like (2,)
        From which to which angle random walk [rad/sqrt(s)].
    sigma : array_like (2,)
        From which to which noise of the camera [rad, 1 sigma]: what `star` is multiplied by.
    gyro_dt, star_dt : float
        Time between gyro samples, and between fixes [s].
    target : float, optional
        Wanted attitude error [rad] at `level` sigma: drawn as a line, and the side of the sensors
        that reach it shaded.
    rrw : float
        Rate random walk of the gyro [rad/s/sqrt(s)].
    star : StarCamera, dict of StarCamera, float, array_like (3,) or (3, 3)
        The camera of noise 1; by default the same about all axes.
    rate : array_like (3,)
        Constant body rate [rad/s].
    axis, level, at
        As for `celestcore.analysis.required_gyro`. All angles of the picture are `level` sigma but
        for the random walk.
    mark : dict of str to (arw, sigma), optional
        Sensors to mark by name.
    width : float
        Width in inches.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    InputError
        Names the field and the value.
    MissingDependencyError
        If matplotlib is not installed.

    Examples
    --------
    >>> import celestcore as cc
    >>> span = (1e-4 * cc.DEG_PER_SQRT_HOUR, 1e-2 * cc.DEG_PER_SQRT_HOUR)
    >>> fig = plot_requirements(span, (1 * cc.ARCSEC, 20 * cc.ARCSEC), 0.1, 0.2,
    ...                         target=1 * cc.ARCSEC)
    >>> len(fig.axes)
    1
    """
    one_of(axis, "axis", AXES)
    one_of(at, "at", AT)
    k, walk = number(level, "level", above=0.0), number(rrw, "rrw", at_least=0.0)
    dt, period = number(gyro_dt, "gyro_dt", above=0.0), number(star_dt, "star_dt", above=0.0)
    x, y = _span(arw, "arw"), _span(sigma, "sigma")
    one = np.eye(3) if star is None else star_covariance(star)
    noise = one * (y * y)[:, None, None, None]
    error = attained(
        np.broadcast_to(x, (len(y), len(x))),
        walk,
        np.broadcast_to(noise, (len(y), len(x), 3, 3)),
        dt,
        period,
        np.array(three(rate, "rate")),
        at,
    )
    error = k * judged(error, axis) / ARCSEC
    fig = plot._new_figure(width, 0.75 * width)
    ax = fig.add_subplot()
    ax.set(xscale="log", yscale="log")  # before the labels, which leave gaps in the lines
    across, up = x / DEG_PER_SQRT_HOUR, k * y / ARCSEC
    ax.set(xlim=across[[0, -1]], ylim=up[[0, -1]])
    _contours(ax, across, up, error, None if target is None else number(target, "target"))
    for name, (walk_of, noise_of) in (mark or {}).items():
        at_x, at_y = walk_of / DEG_PER_SQRT_HOUR, k * noise_of / ARCSEC
        ax.plot(at_x, at_y, "o", color=plot.INK, ms=6, zorder=5, clip_on=False)
        ax.annotate(
            name,
            (at_x, at_y),
            xytext=(7, 5),
            textcoords="offset points",
            fontsize=9,
            color=plot.INK,
            bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
        )
    _label(ax, k, dt, period, walk, f"{_WORDS[at]}, {_axis_words(axis)}")
    return fig


def _axis_words(axis: str) -> str:
    if axis == "worst":
        return "worst axis"
    return "total of three axes" if axis == "total" else f"about body {axis}"


def _span(value: ArrayLike, field: str) -> Array:
    """Return points between two positive ends, evenly spaced in the logarithm."""
    ends = array(value, field, (2,))
    if not (np.all(np.isfinite(ends)) and 0.0 < ends[0] < ends[1]):
        raise InputError("needs two positive numbers, from and to", field=field, value=value)
    return np.geomspace(ends[0], ends[1], _POINTS)


def _levels(low: float, high: float) -> list[float]:
    """Return 1, 2, 5, 10 ... within a range; more of them if it is short."""
    steps = (1.0, 2.0, 5.0) if high > 100.0 * low else (1.0, 1.5, 2.0, 3.0, 4.0, 5.0, 7.0)
    decades = range(int(np.floor(np.log10(low))), int(np.ceil(np.log10(high))) + 1)
    every = [float(f"{s * 10.0**d:.3g}") for d in decades for s in steps]
    return [v for v in every if low < v < high]


def _contours(ax: Axes, x: Array, y: Array, error: Array, target: float | None) -> None:
    low, high = float(error.min()), float(error.max())
    wanted = None if target is None else target / ARCSEC
    levels = [v for v in _levels(low, high) if wanted is None or abs(v / wanted - 1.0) > 0.05]
    _lines(ax, x, y, error, levels, plot.X, 1.1)
    if wanted is None:
        return
    if low <= wanted:
        ax.contourf(x, y, error, levels=[0.0, wanted], colors=[plot.Z], alpha=0.15)
    if low < wanted < high:
        _lines(ax, x, y, error, [wanted], plot.REJECTED, 2.4)
    where = "shaded: reaches" if low <= wanted else "nothing here reaches"
    ax.set_title(f"{where} {wanted:.3g} arcsec", loc="right")


def _lines(
    ax: Axes, x: Array, y: Array, error: Array, levels: list[float], colour: str, wide: float
) -> None:
    """Draw contours with their labels on the diagonal, where there is room for them."""
    diagonal = np.diagonal(error)
    shown = [v for v in levels if diagonal[0] < v < diagonal[-1]]
    if levels:
        lines = ax.contour(x, y, error, levels=levels, colors=colour, linewidths=wide)
        at = np.interp(shown, diagonal, np.arange(len(x)))
        rows = np.arange(len(x))
        places = [(np.interp(k, rows, x), np.interp(k, rows, y)) for k in at]
        if places:
            ax.clabel(lines, levels=shown, manual=places, fmt="{:g}".format, fontsize=9)


def _label(ax: Axes, level: float, dt: float, period: float, rrw: float, words: str) -> None:
    sigma = f"{level:g} sigma"
    walk = f", rate random walk {rrw / ARCSEC:.3g} arcsec/s$^{{1.5}}$" if rrw else ""
    ax.figure.suptitle(
        f"Attitude error [arcsec], {sigma}, {words}",
        x=0.01,
        ha="left",
        fontsize=12,
        weight="bold",
        color=plot.INK,
    )
    right = ax.get_title(loc="right")
    ax.set_title(f"gyro every {dt:g} s, fix every {period:g} s{walk}")
    plot._style(ax)
    ax.set_title(right, fontsize=9, loc="right", color=plot.REJECTED)
    ax.set_xlabel("gyro angle random walk [deg/√h]", fontsize=9, color=plot.INK)
    ax.set_ylabel(f"star camera [arcsec, {sigma}]")
    per_sample = level * DEG_PER_SQRT_HOUR / np.sqrt(dt) / ARCSEC
    top: Any = ax.secondary_xaxis(
        "top", functions=(lambda v: v * per_sample, lambda v: v / per_sample)
    )
    top.set_xlabel(
        f"the same as white noise per sample [arcsec/s, {sigma}]", fontsize=9, color=plot.INK
    )
    top.spines["top"].set_color(plot.SHADE)
    (left, end), (bottom, up) = ax.get_xlim(), ax.get_ylim()
    _plain_ticks(ax.xaxis, end / left)
    _plain_ticks(ax.yaxis, up / bottom)
    _plain_ticks(top.xaxis, end / left)


def _plain_ticks(side: Any, ratio: float) -> None:
    """Give a logarithmic axis plain numbers, few enough to read."""
    ticker: Any = require("matplotlib.ticker", extra="plot", what="plotting")
    steps = (1.0, 2.0, 5.0) if ratio < 200.0 else (1.0, 3.0) if ratio < 1e4 else (1.0,)
    side.set_major_locator(ticker.LogLocator(subs=steps, numticks=50))
    side.set_major_formatter(ticker.FuncFormatter(lambda value, _: f"{value:.4g}"))
    side.set_minor_formatter(ticker.NullFormatter())
    side.set_tick_params(which="both", labelsize=8, colors=plot.INK)


def plot_allan(curve: AllanDeviation, fit: AllanFit | None = None, *, width: float = 8.0) -> Figure:
    """Draw an Allan deviation, and the noise fitted to it.

    Parameters
    ----------
    curve : AllanDeviation
        From `celestcore.analysis.allan_deviation`.
    fit : AllanFit, optional
        From `celestcore.analysis.fit_allan`.
    width : float
        Width in inches.

    Returns
    -------
    matplotlib.figure.Figure

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from celestcore.analysis import allan_deviation
    >>> fig = plot_allan(allan_deviation(np.random.default_rng(1).standard_normal(1000), 1.0))
    >>> fig.axes[0].get_xlabel()
    'averaging time [s]'
    """
    fig = plot._new_figure(width, 0.62 * width)
    ax = fig.add_subplot()
    axes = curve.deviation.shape[1]
    colours = [plot.X, plot.Y, plot.Z]
    names = "xyz" if axes == 3 else [str(k + 1) for k in range(axes)]
    fine = np.geomspace(curve.tau[0], curve.tau[-1], 200)
    for k in range(axes):
        colour = colours[k % 3]
        value, band = curve.deviation[:, k] / DEG_PER_HOUR, curve.sigma[:, k] / DEG_PER_HOUR
        low = np.minimum(band, 0.9 * value)  # a bar must end above zero on this scale
        label = "log" if axes == 1 else f"axis {names[k]}"
        ax.errorbar(
            curve.tau, value, [low, band], fmt="o", ms=4, color=colour, elinewidth=1, label=label
        )
        if fit is not None:
            ax.plot(fine, fit.deviation(fine)[:, k] / DEG_PER_HOUR, "-", color=colour, lw=1.3)
    ax.set_xscale("log")
    ax.set_yscale("log")
    ax.set_title("Allan deviation" + ("" if fit is None else _fitted(fit)))
    ax.set_ylabel("Allan deviation [deg/h]")
    plot._style(ax)
    ax.legend(loc="upper right", fontsize=8, frameon=False)
    ax.set_xlabel("averaging time [s]", fontsize=9, color=plot.INK)
    _plain_ticks(ax.xaxis, float(np.divide(*ax.get_xlim()[::-1])))
    _plain_ticks(ax.yaxis, float(np.divide(*ax.get_ylim()[::-1])))
    return fig


def _fitted(fit: AllanFit) -> str:
    arw, rrw = (np.sqrt(np.mean(v**2)) for v in (fit.arw, fit.rrw))
    return (
        f"; lines: fit, rms over axes N = {arw / DEG_PER_SQRT_HOUR:.3g} deg/√h, "
        f"K = {rrw / ARCSEC:.3g} arcsec/s$^{{1.5}}$"
    )


def plot_trade(result: Trade, *, width: float = 10.0) -> Figure:
    """Draw a trade: the rms position error over the filter period, one panel for each camera.

    Parameters
    ----------
    result : Trade
        From `celestcore.analysis.trade`.
    width : float
        Width in inches.

    Returns
    -------
    matplotlib.figure.Figure
        Bars are 3 standard errors; dashed is the bound of perfect dynamics.

    Raises
    ------
    MissingDependencyError
        If matplotlib is not installed.

    Examples
    --------
    >>> import numpy as np
    >>> from celestcore.analysis import Trade
    >>> grid = np.ones((1, 2, 1))
    >>> made = Trade(("zenith",), np.array([15.0, 60.0]), ("J2",), np.array([5.5]),
    ...              110 * grid[..., 0], 250 * grid, 5 * grid, 15 * grid, 8, False)
    >>> plot_trade(made).axes[0].get_title(loc="left")
    'zenith: 5.5 stars'
    """
    panels = len(result.cameras)
    fig = plot._new_figure(width, 0.42 * width if panels > 1 else 0.6 * width)
    axes = fig.subplots(1, panels, sharey=True, squeeze=False)[0]
    colours = (plot.X, plot.Y, plot.Z, plot.REJECTED, plot.INK)
    for c, ax in enumerate(axes):
        for d, name in enumerate(result.dynamics):
            value, error = result.rms[c, :, d], np.nan_to_num(3.0 * result.error[c, :, d])
            low = np.minimum(error, 0.9 * value)  # a bar must end above zero on this scale
            ax.errorbar(
                result.periods,
                value,
                [low, error],
                fmt="-o",
                ms=4,
                color=colours[d % len(colours)],
                label=name,
            )
        words = "bound of any smoother" if result.smoother else "bound of any filter"
        ax.plot(result.periods, result.bound[c], "--", color=plot.INK, lw=1.2, label=words)
        ax.set(xscale="log", yscale="log")
        ax.set_title(f"{result.cameras[c]}: {result.stars[c]:.1f} stars")
        plot._style(ax)
        ax.set_xlabel("filter period [s]", fontsize=9, color=plot.INK)
        ax.set_xticks(result.periods, [f"{p:g}" for p in result.periods])
        ax.minorticks_off()
        _plain_ticks(ax.yaxis, float(np.divide(*ax.get_ylim()[::-1])))
    axes[0].set_ylabel("position error, rms [m]")
    axes[0].legend(loc="upper left", fontsize=8, frameon=False)
    return fig
