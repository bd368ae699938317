"""Orbit and attitude from a GNSS receiver and a star sensor: a slow error, an outage.

Simulated: three orbits at 506 km, a GNSS fix and a star fix every 10 s, a gyro; the star sensor's
mount bends once an orbit. The receiver is silent for ten minutes. Writes a picture,
``gnss_and_star_sensor.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import celestcore as cc
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

SILENT = (6000.0, 6600.0)  # s


def flight() -> tuple[cc.SensorLog, cc.gnss.GnssStarTrial]:
    """Return a log with an outage, and the truth behind it."""
    scenario = cc.gnss.GnssStarScenario(duration=17000.0, gyro=cc.gnss.GYRO)
    made = scenario.trial(seed=1, trial=0)
    fixes = made.log.gnss
    assert fixes is not None
    keep = (fixes.t < SILENT[0]) | (fixes.t > SILENT[1])
    tables = {**made.log.tables, "gnss": (fixes.t[keep], fixes.r[keep], fixes.v[keep])}
    return cc.SensorLog(epoch=made.log.epoch, **tables), made


def main(folder: str | Path = ".") -> None:
    """Run with and without states for the slow error, smooth, compare with the truth, draw."""
    log, truth = flight()
    gyro = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 0.01 * cc.DEG_PER_HOUR / 60.0)
    slow = cc.LowFrequencyError(amplitudes=(10 * cc.ARCSEC, 3 * cc.ARCSEC))
    star = cc.StarCamera(20 * cc.ARCSEC)
    force = cc.orbit.ForceModel(gravity=20, field=cc.orbit.GravityField.egm2008(20))
    found = {
        "slow error not estimated": cc.GnssStarNavigator(dynamics=force, star=star, gyro=gyro),
        "slow error estimated": cc.GnssStarNavigator(
            dynamics=force, star=star, gyro=gyro, lfe=slow
        ),
    }
    solutions = {name: nav.smooth(log, t_output=truth.t) for name, nav in found.items()}
    best = solutions["slow error estimated"]
    print(best)
    print(best.lfe)
    off = np.linalg.norm(best.r - truth.r_i, axis=1)
    outage = (best.t > SILENT[0]) & (best.t < SILENT[1])
    print(f"position: {off[~outage].max():.2f} m at most, {off[outage].max():.2f} m in the outage")

    figure, axes = plt.subplots(2, 1, figsize=(9, 7), sharex=True, layout="constrained")
    hours = best.t / 3600.0
    sigma = np.linalg.norm(best.sigma_r, axis=1)
    axes[0].semilogy(hours, off, lw=0.8, label="error")
    axes[0].semilogy(hours, sigma, lw=1.2, label="1 sigma")
    axes[0].axvspan(*(s / 3600.0 for s in SILENT), color="0.9", label="no GNSS")
    axes[0].set_ylabel("position [m]")
    for name, sol in solutions.items():
        error = cc.quaternion.log(
            cc.quaternion.multiply(cc.quaternion.conjugate(sol.q), truth.q_ib)
        )
        rms = np.sqrt(np.mean(error[:, 1] ** 2)) / cc.ARCSEC
        print(f"pitch, {name}: {rms:.1f} arcsec rms")
        axes[1].plot(hours, error[:, 1] / cc.ARCSEC, lw=0.8, label=f"{name}: {rms:.1f}″ rms")
    bound = 2.0 * best.sigma_q[:, 1] / cc.ARCSEC
    axes[1].fill_between(hours, -bound, bound, color="C1", alpha=0.2, lw=0, label="2 sigma")
    axes[1].set(ylabel="pitch error [arcsec]", xlabel="time [h]")
    for axis in axes:
        axis.legend(loc="upper right", fontsize=8)
        axis.grid(alpha=0.3)
    path = Path(folder) / "gnss_and_star_sensor.png"
    figure.savefig(path, dpi=110)
    print(f"picture in {path}")


if __name__ == "__main__":
    main(*sys.argv[1:2])
