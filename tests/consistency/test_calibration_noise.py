"""Gyro noise must not pass for a scale factor: estimates without bias, whatever gyro and motion.

A rate that its own noise is part of would bias every scale factor upwards (errors in variables),
the more the longer the log: by five to ten sigma in the first four cases.
"""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import simulate

RUNS = 16
ERRORS = np.array([1e-3, -2e-3, 5e-4])


def sines(size: float, duration: float, dt: float) -> simulate.Truth:
    """Turn about three axes at three periods, with rates up to `size` [rad/s]."""
    t = np.arange(0.0, duration, dt)
    phase = 2.0 * np.pi * (t[:, None] + 0.5 * dt) / [97.0, 131.0, 173.0]
    rate = size * np.sin(phase + np.arange(3.0))
    return simulate.attitude(t, cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], dt))


CASES = {
    "earth pointing, hours": (simulate.earth_pointing(15_000.0, 0.5), 2e-6, False),
    "earth pointing, poor gyro": (simulate.earth_pointing(2000.0, 0.2), 2e-5, False),
    "slow turns, poor gyro": (sines(1e-3, 3000.0, 0.25), 1e-4, True),
    "turns, bad gyro": (sines(5e-3, 6000.0, 0.5), 3e-4, True),
    "slews, bad gyro": (simulate.slews(1500.0, 0.25), 5e-4, True),
}


@pytest.mark.parametrize("case", list(CASES))
def test_estimates_are_not_biased_by_gyro_noise(case: str) -> None:
    truth, arw, moving = CASES[case]
    gyro = simulate.GyroErrors(arw, 3e-9, bias_sigma=1e-5, scale=ERRORS if moving else 0.0)
    star = simulate.StarErrors(5.0 * cc.ARCSEC, period=1.0)
    scenario = simulate.Scenario(truth, gyro, star)
    z = []
    for trial in range(RUNS):
        log = scenario.simulate(seed=20, trial=trial).log
        nav = scenario.navigator(cc.EKF())
        found = nav.calibrate(log, sigma0=(1e-3, 1e-5))
        true = np.concatenate([ERRORS if moving else np.zeros(3), np.zeros(6)])
        value, sigma = np.array(list(found.value.values())), np.array(list(found.sigma.values()))
        z.append((value - true) / sigma)
    mean, rms = np.mean(z, axis=0), np.sqrt(np.mean(np.square(z), axis=0))
    print(case, mean.round(2), rms.round(2))
    # of the mean over runs 4.2 sigma: one in a thousand sets of nine figures and five cases
    assert np.abs(mean).max() < 4.2 / np.sqrt(RUNS)
    # what is not observable stays at its prior, nearer than its sigma; the rest scatters as it says
    assert rms.max() < 1.9
    if moving:
        assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.2)


def test_what_is_not_observable_is_not_corrected() -> None:
    truth, arw, _ = CASES["earth pointing, poor gyro"]
    star = simulate.StarErrors(5.0 * cc.ARCSEC, period=1.0)
    scenario = simulate.Scenario(truth, simulate.GyroErrors(arw, 3e-9, bias_sigma=1e-5), star)
    found = scenario.navigator(cc.EKF()).calibrate(scenario.simulate(seed=3).log)
    assert not any(found.observable.values())
    assert np.all(np.asarray(found.navigator.gyro.errors) == 0.0)
