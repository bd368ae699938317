"""Figures 2 to 7 of the paper, with the reproduction in them, and one of all ratios."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore.plot import GRID, INK, REJECTED, X, Y, Z, _new_figure, _style
from celestcore.reproduce._paper import AXES, GYRO, STAR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from celestcore.reproduce.star_gyro import Result

PURPLE = "#CC79A7"
CAMERAS = ((X, "o"), (Y, "s"), (Z, "^"))


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures by file name, without its ending."""
    out = {f"figure_{2 + k}": experiment_3(result, k) for k in range(3)}
    out |= {f"figure_{5 + k}": cameras(result, k) for k in range(3)}
    return out | {"ratios": ratios(result)}


def experiment_3(result: Result, axis: int) -> Figure:
    """Draw Figures 2 to 4: the 1 arcsec camera, one axis."""
    fig = _new_figure(7.6, 4.6)
    ax = fig.add_subplot()
    camera = STAR.index(1.0)

    def column(name: str) -> Any:
        return result.figures(name)[camera, :, axis]

    ax.plot(GYRO, column("paper_ekf"), "o", mfc="white", mec=REJECTED, mew=1.4, label="paper, EKF")
    ax.plot(GYRO, column("r2"), color=REJECTED, lw=1.4, label="reproduced (R2)")
    ax.plot(GYRO, column("paper_ukf"), "s", mfc="white", mec=X, mew=1.4, label="paper, UKF")
    ax.plot(GYRO, column("r1"), color=X, lw=1.4, label="reproduced (R1)")
    ax.plot(GYRO, column("mekf"), ".", color=Z, ms=9, label="tuned, EKF and UKF alike")
    ax.plot(GYRO, column("bound_filter"), color=Z, lw=1.2, label="bound of any causal filter")
    ax.plot(GYRO, column("smoothed"), ".", color=PURPLE, ms=9, label="smoothed (not causal)")
    ax.plot(GYRO, column("bound_smoother"), color=PURPLE, lw=1.2, label="bound of any smoother")
    _finish(ax, f"Figure {2 + axis}: {AXES[axis]}, 1″ camera", columns=1)
    return fig


def cameras(result: Result, axis: int) -> Figure:
    """Draw Figures 5 to 7: the UKF with all three cameras, one axis."""
    fig = _new_figure(7.6, 4.6)
    ax = fig.add_subplot()
    for k, (colour, mark) in enumerate(CAMERAS):
        paper, again = result.figures("paper_ukf")[k], result.figures("r1")[k]
        tuned = result.figures("ukf")[k]
        name = f"{STAR[k]:g}″"
        ax.plot(
            GYRO, paper[:, axis], mark, mfc="white", mec=colour, mew=1.4, label=f"{name} paper, UKF"
        )
        ax.plot(GYRO, again[:, axis], color=colour, lw=1.4, label=f"{name} reproduced (R1)")
        ax.plot(GYRO, tuned[:, axis], "--", color=colour, lw=1.2, label=f"{name} tuned UKF")
    _finish(ax, f"Figure {5 + axis}: {AXES[axis]}, UKF with the three cameras", columns=3)
    ax.set_ylim(top=1.25 * ax.get_ylim()[1])
    return fig


def ratios(result: Result) -> Figure:
    """Draw each of the 108 figures of R1 and R2 over the paper's."""
    fig = _new_figure(9.5, 4.2)
    axes = fig.subplots(1, 2, sharey=True)
    for ax, (name, column, title) in zip(
        axes,
        (
            ("r1", "paper_ukf", "Block R1 over the paper's UKF"),
            ("r2", "paper_ekf", "Block R2 over the paper's EKF"),
        ),
        strict=True,
    ):
        ratio = result.figures(name) / result.figures(column)
        ax.axhspan(0.9, 1.1, color=GRID, alpha=0.6, lw=0)
        ax.axhline(1.0, color=INK, lw=0.8)
        for k, (colour, mark) in enumerate(CAMERAS):
            for j in range(3):
                x = np.asarray(GYRO) + 0.03 * (j - 1)
                label = f"{STAR[k]:g}″ camera" if j == 0 else None
                ax.plot(x, ratio[k, :, j], mark, ms=4, color=colour, alpha=0.85, label=label)
        _finish(ax, title, columns=3)
        ax.set_ylim(0.78, 1.25)
    axes[0].set_ylabel("reproduced / published")
    axes[1].set_ylabel("")
    return fig


def _finish(ax: Axes, title: str, columns: int) -> None:
    ax.set_title(title)
    ax.set_xlabel("gyro error [arcsec/s, 3 sigma]", fontsize=9, color=INK)
    ax.set_ylabel("attitude error [arcsec, 3 sigma]")
    ax.set_xlim(0.1, 2.5)
    ax.set_xticks(GYRO)
    ax.set_ylim(bottom=0.0)
    _style(ax)
    ax.tick_params(axis="x", labelsize=7.5)
    ax.legend(loc="upper left", fontsize=8, frameon=False, ncols=columns, labelcolor=INK)
