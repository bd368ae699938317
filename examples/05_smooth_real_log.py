"""Run and smooth a real log with a hole in its fixes; what lies in the hole tells who is right.

``python examples/05_smooth_real_log.py [FOLDER]`` writes ``fermi_smoothed.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import celestcore as cc
import matplotlib.pyplot as plt
import numpy as np

HOLE = (19_800.0, 20_400.0)  # s; the fixes in these ten minutes are kept from the filter
AROUND = (HOLE[0] - 600.0, HOLE[1] + 600.0)
FILTER, SMOOTHER = "#b45309", "#1d4ed8"


def attitude_error(truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (n, 3) from estimate to truth, body frame, in arcsec."""
    turn = cc.quaternion.multiply(cc.quaternion.conjugate(estimate), truth)
    return cc.quaternion.log(turn) / cc.ARCSEC


def picture(
    filtered: cc.Solution, smoothed: cc.Solution, errors: dict[str, tuple[np.ndarray, ...]]
) -> plt.Figure:
    fig, (top, middle, bottom) = plt.subplots(3, sharex=True, figsize=(8, 9), layout="constrained")
    inside = (filtered.t > AROUND[0]) & (filtered.t < AROUND[1])
    minutes = (filtered.t[inside] - HOLE[0]) / 60.0

    both = (("filter", filtered, FILTER), ("smoother", smoothed, SMOOTHER))
    for name, sol, colour in both:
        sigma = np.linalg.norm(sol.sigma[inside, :3], axis=1) / cc.ARCSEC
        top.plot(minutes, sigma, color=colour, label=name)
    top.set(yscale="log", ylabel="attitude sigma [arcsec]")
    top.set_title("Fermi: ten minutes of star fixes withheld (grey)", loc="left")

    # what the later fixes have changed; its covariance is the difference of both covariances
    change = attitude_error(smoothed.q[inside], filtered.q[inside])
    variance = filtered.sigma[inside, :3] ** 2 - smoothed.sigma[inside, :3] ** 2
    bound = 3.0 * np.sqrt(variance.max(axis=1)) / cc.ARCSEC
    middle.fill_between(minutes, -bound, bound, color="0.92", label="change expected, 3 sigma")
    for axis, values in zip("xyz", change.T, strict=True):
        middle.plot(minutes, values, lw=1.0, label=axis)
    middle.set(ylabel="smoother less filter [arcsec]")

    for name, _, colour in both:
        t, error, sigma = errors[name]
        size = np.linalg.norm(error, axis=1)
        bottom.plot((t - HOLE[0]) / 60.0, size, color=colour, label=f"{name}, against the fixes")
        bottom.plot(
            (t - HOLE[0]) / 60.0, sigma, "--", color=colour, lw=1.0, label=f"{name}'s sigma"
        )
    bottom.set(xlabel="minutes from the last fix", ylabel="attitude error [arcsec]")
    for ax in (top, middle, bottom):
        ax.axvspan(0.0, (HOLE[1] - HOLE[0]) / 60.0, color="0.5", alpha=0.12, lw=0.0)
        ax.grid(alpha=0.3)
        ax.margins(x=0.0)
        ax.legend(loc="upper left", fontsize="small", ncols=2)
    return fig


def main(folder: str | Path = ".") -> None:
    whole = cc.sample("fermi")
    fixes = whole.stars["star"]
    hidden = (fixes.t > HOLE[0]) & (fixes.t < HOLE[1])
    log = cc.SensorLog(
        epoch=whole.epoch,
        gyro=(whole.gyro.t, whole.gyro.rate),
        star=(fixes.t[~hidden], fixes.q[~hidden]),
    )
    nav = cc.Settings.from_log(whole).navigator()
    filtered = nav.run(log)
    smoothed = nav.smooth(filtered)  # replays the same log forward, then goes back over it

    errors = {}
    for name, sol in (("filter", filtered), ("smoother", smoothed)):
        there = sol.at(fixes.t[hidden])
        error = attitude_error(fixes.q[hidden], there.q)
        sigma = np.linalg.norm(there.sigma[:, :3], axis=1) / cc.ARCSEC
        errors[name] = (there.t, error, sigma)
        rms = np.sqrt(np.mean(np.sum(error**2, axis=1)))
        expected = np.sqrt(np.mean(sigma**2))
        print(f"{name}: {rms:.1f} arcsec rms from the fixes withheld, {expected:.0f} expected")
    usual = np.median(filtered.sigma[:, :3]), np.median(smoothed.sigma[:, :3])
    print(f"with a fix every second: sigma {usual[0] / cc.ARCSEC:.2f} arcsec an axis,", end=" ")
    print(f"smoothed {usual[1] / cc.ARCSEC:.2f}")

    target = Path(folder) / "fermi_smoothed.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    fig = picture(filtered, smoothed, errors)
    fig.savefig(target, dpi=120)
    plt.close(fig)
    print(f"wrote {target}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
