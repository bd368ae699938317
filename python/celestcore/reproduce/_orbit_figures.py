"""Figures 3 and 4 of the paper, the errors against the period, and the particles' weights."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore.plot import INK, REJECTED, X, Y, Z, _new_figure, _style
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_model import PERIODS, Cell
from celestcore.reproduce._orbit_scores import MEAN_OVER_RMS
from celestcore.reproduce._orbit_targets import WORDS, means

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celestcore.reproduce.celestial_orbit import Result

PURPLE, SKY = "#CC79A7", "#56B4E9"
LINES = {
    "ekf_taylor": (REJECTED, "EKF (Taylor step)"),
    "ukf": (X, "UKF"),
    "upf": (Y, "UPF-20"),
    "score": (PURPLE, "score filter"),
    "ekf_21x21": (Z, "EKF, 21×21 gravity"),
    "smoothed_21x21": (INK, "the same, smoothed"),
}
FORMS = {
    "upf": (Y, "one proposal (the default)"),
    "upf_bank": (X, "bank of UKFs"),
    "upf_literal": (REJECTED, "the paper's literal steps"),
}
HOUR = 3600.0


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures by file name, without its ending."""
    return {
        "period": by_period(result),
        "figure_3": figure_3(result),
        "figure_4": figure_4(result),
        "effective_sample_size": sample_sizes(result),
    }


def by_period(result: Result) -> Figure:
    """Draw the mean position error over the filter period: the paper's, ours, and the bound."""
    fig = _new_figure(9.5, 4.4)
    axes = fig.subplots(1, 2, sharey=True)
    for ax, noise in zip(axes, ("A", "B"), strict=True):
        for name, (colour, label) in LINES.items():
            if name != "score":
                ax.plot(PERIODS, means(result, name, noise), "-o", ms=4, color=colour, label=label)
        bounds = [MEAN_OVER_RMS * result.bounds[Cell(p, noise)].filter for p in PERIODS]
        ax.plot(PERIODS, bounds, "--", color=Z, lw=1.0, label="bound of any filter")
        if noise == "A":
            _published(ax)
        ax.set(xscale="log", yscale="log", xticks=PERIODS, ylim=(25.0, 6000.0))
        ax.set_title(f"Noise {noise}")
        _finish(ax, "filter period [s]")
        ax.set_xticks(PERIODS, [f"{p:g}" for p in PERIODS])
        ax.minorticks_off()
        ax.set_yticks([30, 100, 300, 1000, 3000], ["30", "100", "300", "1000", "3000"])
    axes[0].set_ylabel("mean position error [m]")
    axes[0].legend(loc="upper left", fontsize=7.5, frameon=False, labelcolor=INK, ncols=2)
    return fig


def _published(ax: Axes) -> None:
    marks = (("EKF", "^", REJECTED), ("UKF", "s", X), ("UPF", "D", Y))
    for column, mark, colour in marks:
        rows = [paper.row(p, "normal", column) for p in PERIODS]
        values = [np.nan if r is None else r.mean_pos for r in rows]
        ax.plot(
            PERIODS,
            values,
            mark,
            mfc="white",
            mec=colour,
            mew=1.4,
            label=f"paper, {column}",
            zorder=4,
        )


def figure_3(result: Result) -> Figure:
    """Draw Figure 3: the error of one run over time, by period."""
    names = ("ekf_taylor", "ukf", "upf", "ekf_21x21", "smoothed_21x21")
    panels = {f"{p:g} s": f"T = {p:g} s" for p in (3.0, 30.0, 60.0)}
    return _runs(result, panels, names, "Figure 3")


def figure_4(result: Result) -> Figure:
    """Draw Figure 4: the error of one run over time, by distribution of the noise."""
    return _runs(result, WORDS, ("ekf_taylor", "ukf", "upf", "score"), "Figure 4")


def _runs(result: Result, panels: dict[str, str], names: tuple[str, ...], what: str) -> Figure:
    fig = _new_figure(9.5, 7.4)
    axes: Any = fig.subplots(len(panels), 1, sharex=True)
    for ax, (key, title) in zip(axes, panels.items(), strict=True):
        found = result.traces.errors.get(key, {})
        for name in names:
            if name in found:
                t, error = found[name]
                colour, label = LINES[name]
                # dashed where it lies upon the UKF's
                line = (0, (4, 4)) if name == "upf" else "-"
                ax.plot(t / HOUR, error, color=colour, lw=0.9, ls=line, label=label)
        ax.set_yscale("log")
        ax.set_title(f"{what}: {title}")
        ax.axvline(200.0 * 60.0 / HOUR, color=INK, lw=0.7, ls=":")
        _finish(ax, "")
        ax.set_ylabel("position error [m]", fontsize=8)
    axes[0].legend(loc="upper right", fontsize=7.5, frameon=False, ncols=5, labelcolor=INK)
    axes[-1].set_xlabel("time [h]; scored from the dotted line on", fontsize=9, color=INK)
    return fig


def sample_sizes(result: Result) -> Figure:
    """Draw the effective sample size of the three particle filters over one run."""
    fig = _new_figure(9.5, 3.6)
    ax = fig.add_subplot()
    for name, (colour, label) in FORMS.items():
        if name in result.traces.ess:
            t, ess = result.traces.ess[name]
            ax.plot(t / HOUR, ess, ".", ms=2.0, color=colour, alpha=0.35)
            ax.plot(t / HOUR, _running(ess), color=colour, lw=1.6, label=label)
    ax.set_ylim(0.0, 1.22 * paper.PARTICLES)
    ax.axhline(paper.PARTICLES, color=INK, lw=0.7)
    ax.axhline(1.0, color=INK, lw=0.7, ls=":")
    ax.set_title("Effective sample size of 20 particles before resampling, T = 15 s")
    _finish(ax, "time [h]; 20 is the best there is, 1 means that one particle has all the weight")
    ax.legend(loc="upper right", fontsize=8, frameon=False, ncols=3, labelcolor=INK)
    return fig


def _running(values: Any, width: int = 41) -> Any:
    """Return the mean over a window about each value, less of it at the ends."""
    kernel = np.ones(min(width, len(values)))
    good = np.isfinite(values)
    total = np.convolve(np.where(good, values, 0.0), kernel, "same")
    return total / np.maximum(np.convolve(good, kernel, "same"), 1.0)


def _finish(ax: Axes, label: str) -> None:
    _style(ax)
    ax.set_xlabel(label, fontsize=9, color=INK)
