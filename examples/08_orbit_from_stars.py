"""An orbit from stars and the horizon: filter, smoother, their sigmas, and the bound of any filter.

Simulated: every 30 s a satellite at 760 km sees up to six stars at the zenith, and the nadir by a
horizon sensor. Writes a picture, ``orbit_from_stars.png``.
"""

from __future__ import annotations

import sys
from pathlib import Path

import celestcore as cc
import matplotlib as mpl
import numpy as np

mpl.use("Agg")
import matplotlib.pyplot as plt

EPOCH = "2007-07-01T12:00:00"
PERIOD = 30.0  # s
ORBITS = 4
SETTLED = 6000.0  # s: an orbit


def flight() -> cc.celestial.Scenario:
    """Fly all forces there are, and look at the sky."""
    orbit = cc.elements.Elements(7136.635e3, 1.8e-3, 65 * cc.DEG, 30 * cc.DEG, 30 * cc.DEG, 0.0)
    r0, v0 = cc.elements.to_state(orbit)
    t = np.arange(0.0, ORBITS * 6000.0 + 1.0, PERIOD)
    truth = cc.orbit.propagate(cc.orbit.ForceModel.high_fidelity(), EPOCH, r0, v0, t)
    stars = cc.StarCatalogue.hipparcos(epoch=EPOCH, magnitude=6.0)
    camera = cc.celestial.SkyCamera(stars, field_of_view=(10 * cc.DEG, 10 * cc.DEG))
    # now and then a star is taken for another one
    return cc.celestial.Scenario(
        truth, camera, cc.StarHorizon(), period=PERIOD, outliers=(0.02, 50.0)
    )


def main(folder: str | Path = ".") -> None:
    """Run, smooth, compare with the truth and the bound, draw."""
    scenario = flight()
    log, start = scenario.log(seed=7), scenario.start(seed=7)
    force = cc.orbit.ForceModel(gravity=21, sun=True, moon=True)
    dynamics = cc.orbit.OrbitDynamics(force, accel_psd=3e-11)
    nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon(), gate=0.9999)
    run = nav.run(log, *start, sigma0=scenario.start_sigma)
    best = nav.smooth(log, *start, sigma0=scenario.start_sigma)
    bound = cc.analysis.posterior_bound(scenario)

    settled = run.t >= SETTLED
    errors = {
        name: np.linalg.norm(sol.r - scenario.truth.r, axis=1)
        for name, sol in (("filter", run), ("smoother", best))
    }
    print(f"{run.counts['angles']} angles, {run.counts['rejected']} rejected")
    for name, error in errors.items():
        print(f"{name}: {error[settled].mean():.0f} m on average after an orbit")
    position, velocity = bound.rms(skip=SETTLED)
    print(f"over many flights no filter is better than {position:.0f} m, {velocity:.2f} m/s (rms)")

    fig, ax = plt.subplots(figsize=(9.0, 4.2), layout="constrained")
    colours = {"filter": "#0072b2", "smoother": "#222222"}
    for (name, error), sol in zip(errors.items(), (run, best), strict=True):
        ax.plot(sol.t / 3600.0, error, color=colours[name], lw=1.0, label=f"{name}, error")
        sigma = np.linalg.norm(sol.sigma[:, :3], axis=1)
        ax.plot(sol.t / 3600.0, sigma, color=colours[name], lw=1.0, ls="--", label="its 1 sigma")
    ax.set(yscale="log", xlabel="time [h]", ylabel="position [m]", xlim=(0.0, run.t[-1] / 3600.0))
    ax.legend(frameon=False, ncols=2)
    ax.spines[["top", "right"]].set_visible(False)
    target = Path(folder) / "orbit_from_stars.png"
    target.parent.mkdir(parents=True, exist_ok=True)
    fig.savefig(target, dpi=120)
    plt.close(fig)
    print(f"picture: {target}")


if __name__ == "__main__":
    main(*sys.argv[1:])
