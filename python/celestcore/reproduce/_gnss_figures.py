"""Figures 3 to 7 of the paper, the slew, the slow error, and the errors at a glance."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore.plot import GRID, INK, REJECTED, SHADE, X, Z, _new_figure, _style
from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_model import SKIP
from celestcore.reproduce._gnss_targets import SEEN, UNSEEN
from celestcore.units import ARCSEC, DEG

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celestcore.reproduce._gnss_series import Array
    from celestcore.reproduce.gnss_star import Result

PURPLE = "#CC79A7"
MINUTE = 60.0
GLANCE = {
    "position_gps": "raw GPS",
    "position_kinematic": "kinematic filter",
    "position_kinematic_smoothed": "kinematic smoother",
    "position_zonal": "filter, zonal gravity",
    "position_4x4": "filter, 4×4",
    "position_8x8": "filter, 8×8",
    "position_20x20": "filter, 20×20",
    "position_20x20_smoothed": "smoothed, 20×20",
}
GLANCE_PITCH = {
    "pitch_star_lfe": "raw star sensor, LFE",
    "pitch_lfe": "filter, LFE",
    "pitch_lfe_smoothed": "smoothed, LFE",
    "pitch_star": "raw star sensor",
    "pitch_no_lfe": "filter",
    "pitch_no_lfe_smoothed": "smoothed",
}
GLANCE_GYRO = {
    "pitch_gyro_lfe": "filter, gyro, LFE",
    "pitch_gyro_lfe_smoothed": "smoothed, gyro, LFE",
}
COLOURS = {1.0: X, 10.0: REJECTED}


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures by file name, without its ending."""
    return {
        "errors": glance(result),
        "figure_3_4_6": tracks(result),
        "figure_5": over_time(result, 1.0, "Figure 5"),
        "figure_7": over_time(result, 10.0, "Figure 7"),
        "slew": slew(result),
        "observability": slow_error(result),
    }


def glance(result: Result) -> Figure:
    """Draw rms errors of position and pitch, with their targets."""
    fig = _new_figure(10.0, 3.7)
    left, right = fig.subplots(1, 2)
    for gps in paper.GPS:
        _dots(left, result, GLANCE, gps)
        _dots(right, result, GLANCE_PITCH, gps)
    _dots(right, result, GLANCE_GYRO, 1.0, below=len(GLANCE_PITCH))
    left.set_xscale("log")
    left.set_xlim(0.15, 30.0)
    left.set_xticks([0.2, 0.5, 1, 2, 5, 10, 20], ["0.2", "0.5", "1", "2", "5", "10", "20"])
    left.minorticks_off()
    right.axvline(paper.PITCH / ARCSEC, color=INK, lw=1.0, ls=":")
    right.text(
        paper.PITCH / ARCSEC - 1.0,
        0.0,
        "the paper's\n0.02° = 72″",
        fontsize=8,
        color=INK,
        ha="right",
        va="center",
    )
    right.set_xlim(0.0, 78.0)
    for ax, names, what in (
        (left, list(GLANCE.values()), "position error, rms [m]"),
        (right, [*GLANCE_PITCH.values(), *GLANCE_GYRO.values()], "pitch error, rms [arcsec]"),
    ):
        ax.set_yticks(range(len(names)), names)
        ax.set_ylim(len(names) - 0.5, -0.6)
        _style(ax)
        ax.set_xlabel(what, fontsize=9, color=INK)
    left.plot([], [], "|", color=INK, ms=11, mew=1.4, label="target: at most")
    left.plot([], [], ":", color=INK, lw=1.0, label="bound")
    fig.legend(
        *left.get_legend_handles_labels(),
        loc="outside upper center",
        fontsize=8,
        frameon=False,
        ncols=4,
        labelcolor=INK,
    )
    return fig


def _dots(ax: Axes, result: Result, names: dict[str, str], gps: float, below: int = 0) -> None:
    colour = COLOURS[gps]
    # a ring about the dot of 1 m, where both levels have the same figure
    mark: Any = {"mfc": "none", "mew": 1.6} if gps != 1.0 and names is GLANCE_PITCH else {}
    for k, name in enumerate(names, start=below):
        figure = result.figures[f"{name}_{gps:g}m"]
        label = f"{gps:g} m GPS" if k == 0 else None
        size = 10 if mark else 5
        ax.plot(figure.series.value, k, "o", ms=size, color=colour, label=label, **mark)
        most, bound = figure.at_level(figure.asked.most), figure.at_level(figure.asked.bound)
        if most is not None:
            ax.plot(most, k, "|", color=INK, ms=13, mew=1.4)
        if bound is not None and names is GLANCE:
            ax.plot([bound, bound], [k - 0.33, k + 0.33], ":", color=colour, lw=1.3)
    ax.tick_params(axis="y", labelsize=8)


def tracks(result: Result) -> Figure:
    """Draw Figures 3, 4 and 6: the track, and how far fixes and filtered track are from it."""
    fig = _new_figure(10.0, 5.6)
    axes: Any = fig.subplots(2, 3, height_ratios=(1.5, 1.0))
    flights = result.traces.flights
    titles = (
        "Figure 3: original track",
        "Figure 4: filtered, 1 m GPS",
        "Figure 6: filtered, 10 m GPS",
    )
    for k, title in enumerate(titles):
        flight = flights[paper.GPS[max(k - 1, 0)]]
        shown, fixes = (flight.track if k == 0 else flight.filtered), flight.fixes
        ax = axes[0, k]
        if k:
            ax.plot(*_degrees(fixes), ".", ms=4, color=SHADE, label="GPS fixes")
        colour = INK if k == 0 else COLOURS[paper.GPS[k - 1]]
        ax.plot(*_degrees(shown), color=colour, lw=1.4, label="true" if k == 0 else "filtered")
        ax.plot(*_degrees(shown[:1]), "o", ms=5, color=colour, label="start, 04:00")
        ax.set_title(title)
        ax.set_xlabel("longitude [°]", fontsize=9, color=INK)
        ax.legend(loc="best", fontsize=7.5, frameon=False, labelcolor=INK)
        _style(ax)
    axes[0, 0].set_ylabel("latitude [°]")
    height = flights[1.0]
    axes[1, 0].plot(height.t / MINUTE, height.track[:, 2] / 1e3, color=INK, lw=1.4)
    axes[1, 0].set_ylabel("height [km]")
    for k, gps in enumerate(paper.GPS, start=1):
        _deviations(axes[1, k], flights[gps], COLOURS[gps])
    for ax in axes[1]:
        ax.set_xlabel("time [min]", fontsize=9, color=INK)
        _style(ax)
    axes[1, 1].set_ylabel("height error [m]")
    return fig


def _degrees(track: Array) -> tuple[Array, Array]:
    return np.unwrap(track[:, 0]) / DEG, track[:, 1] / DEG


def _deviations(ax: Axes, flight: Any, colour: str) -> None:
    t = flight.t / MINUTE
    ax.plot(t, flight.fixes[:, 2] - flight.track[:, 2], ".", ms=4, color=SHADE)
    ax.plot(t, flight.filtered[:, 2] - flight.track[:, 2], color=colour, lw=1.4)
    ax.axhline(0.0, color=INK, lw=0.6)


def over_time(result: Result, gps: float, title: str) -> Figure:
    """Draw Figure 5 or 7: position and attitude errors of one run with 3-sigma bands."""
    flight = result.traces.flights[gps]
    fig = _new_figure(10.0, 6.4)
    axes: Any = fig.subplots(3, 2, sharex=True)
    parts = (
        (flight.position, flight.position_sigma, flight.raw_position, 1.0),
        (flight.attitude, flight.attitude_sigma, flight.raw_attitude, ARCSEC),
    )
    names = (("along track", "to the right", "down"), ("roll", "pitch", "yaw"))
    t = flight.t / MINUTE
    for column, (error, sigma, raw, unit) in enumerate(parts):
        colour, unit_name = (COLOURS[gps], "m") if column == 0 else (Z, "arcsec")
        late = flight.t > 60.0
        limit = 1.15 * max(np.abs(raw).max(), 3.0 * sigma[late].max()) / unit
        for k, ax in enumerate(axes[:, column]):
            band = 3.0 * sigma[:, k] / unit
            ax.fill_between(t, -band, band, color=colour, alpha=0.16, lw=0, label="±3 sigma")
            ax.plot(t, raw[:, k] / unit, ".", ms=3.5, color="#888888", label="raw fixes")
            ax.plot(t, error[:, k] / unit, color=colour, lw=1.4, label="filtered")
            ax.axvline(SKIP / MINUTE, color=INK, lw=0.7, ls=":")
            ax.set_ylim(-limit, limit)
            ax.set_ylabel(f"{names[column][k]} [{unit_name}]")
            _style(ax)
        axes[0, column].set_title(
            ("position error", "attitude error")[column], fontsize=9.5, loc="left", color=INK
        )
        axes[0, column].legend(
            loc="lower right",
            bbox_to_anchor=(1.0, 0.98),
            ncols=3,
            fontsize=8,
            frameon=False,
            labelcolor=INK,
        )
        axes[-1, column].set_xlabel(
            "time [min]; filters are scored from the dotted line on", fontsize=9, color=INK
        )
    fig.suptitle(f"{title}: {gps:g} m GPS, first run", fontsize=10.5, color=INK, x=0.02, ha="left")
    return fig


def slew(result: Result) -> Figure:
    """Draw a slew through 90 degrees: the Euler filters beside the navigator."""
    turn = result.traces.turn
    fig = _new_figure(10.0, 4.8)
    top, ax = fig.subplots(2, 1, sharex=True, height_ratios=(1.0, 2.2))
    t = turn.t / MINUTE
    crossing = float(np.interp(90.0 * DEG, turn.pitch, t))
    top.plot(t, turn.pitch / DEG, color=INK, lw=1.4)
    top.axhline(90.0, color=INK, lw=0.7, ls="--")
    top.set_yticks([0, 45, 90, 120])
    top.set_ylabel("pitch turned [°]")
    ax.plot(
        t,
        turn.euler / ARCSEC,
        color=REJECTED,
        lw=1.5,
        label="three Kalman filters on Euler angles (the paper's scheme)",
    )
    ax.plot(t, turn.star / ARCSEC, ".", ms=4, color="#888888", label="raw star sensor")
    ax.plot(t, turn.navigator / ARCSEC, color=Z, lw=1.5, label="GnssStarNavigator (MEKF)")
    for each in (top, ax):
        each.axvline(crossing, color=INK, lw=0.7, ls=":")
        _style(each)
    ax.axhline(1.0 * DEG / ARCSEC, color=INK, lw=0.7, ls="--")
    ax.text(0.0, 0.8 * DEG / ARCSEC, "1°", fontsize=8, color=INK, va="top")
    ax.set_yscale("log")
    ax.set_ylim(0.7, 4e5)
    ax.set_ylabel("attitude error [arcsec]")
    ax.set_xlabel("time [min]; the dotted line is 90° of pitch", fontsize=9, color=INK)
    ax.legend(loc="upper left", fontsize=8, frameon=False, labelcolor=INK)
    return fig


def slow_error(result: Result) -> Figure:
    """Draw what three orbits with a gyro tell of the slow error."""
    slow, observed = result.traces.slow, result.observed
    fig = _new_figure(10.0, 3.9)
    left, right = fig.subplots(1, 2, width_ratios=(1.0, 1.25))
    left.axhspan(UNSEEN, 1.06, color=REJECTED, alpha=0.13, lw=0)
    left.axhspan(0.0, SEEN, color=Z, alpha=0.13, lw=0)
    left.text(0.6, 0.93, "not seen: 0.98 or more", fontsize=8, color=INK, va="top")
    left.text(6.4, 0.03, "seen: at most 0.5", fontsize=8, color=INK, ha="right")
    place = np.arange(1, observed.first.shape[1] + 1)
    left.plot(place, observed.first.T, "o", color=X, ms=6)
    left.set_xlim(0.5, 6.5)
    left.set_ylim(0.0, 1.06)
    left.set_ylabel("sigma after / sigma before")
    left.set_title("first harmonic: combinations of its six coefficients")
    left.set_xlabel(
        f"combination; {len(observed.first)} runs lie on each other", fontsize=9, color=INK
    )
    t = slow.t / 3600.0
    right.fill_between(
        t,
        (slow.found - 3.0 * slow.sigma) / ARCSEC,
        (slow.found + 3.0 * slow.sigma) / ARCSEC,
        color=X,
        alpha=0.15,
        lw=0,
        label="±3 sigma",
    )
    right.plot(t, slow.true / ARCSEC, color=INK, lw=1.2, ls="--", label="true")
    right.plot(t, slow.found / ARCSEC, color=X, lw=1.5, label="estimated")
    right.set_title("low-frequency error about the pitch axis, first run")
    right.set_ylabel("[arcsec]")
    right.set_xlabel("time [h]", fontsize=9, color=INK)
    right.legend(loc="lower center", fontsize=8, frameon=False, ncols=3, labelcolor=INK)
    for ax in (left, right):
        _style(ax)
    low, high = right.get_ylim()
    right.set_ylim(low - 0.12 * (high - low), high)
    left.grid(axis="x", color=GRID, lw=0.0)
    return fig
