"""Slews show a gyro's scale factors and misalignments and how two star cameras are aligned."""

from __future__ import annotations

import celestcore as cc
import numpy as np

ARW, RRW = 1.5e-6, 3e-9  # rad/sqrt(s), rad/s/sqrt(s)
SIGMA = 5 * cc.ARCSEC
STEP, SLEW = 0.1, 60.0  # s; each slew turns the body by 60 degrees
GYRO = 1e-3 * np.array([[0.8, 0.5, -0.3], [-0.4, -1.1, 0.2], [0.6, -0.2, 0.5]])  # M
TURNED = np.array([60.0, -40.0, 90.0]) * cc.ARCSEC  # of the second camera


def slews(axes: str) -> np.ndarray:
    """Return body rates (n, 3): about each axis a slew there and back, from rest to rest."""
    s = np.arange(0.0, 1.0, STEP / SLEW)
    shape = np.radians(60.0) / SLEW * 30.0 * s**2 * (1.0 - s) ** 2
    rest = np.zeros(300)
    one = np.concatenate([shape, rest, -shape, rest])
    return np.concatenate([one[:, None] * np.eye(3)["xyz".index(axis)] for axis in axes])


def simulate(rate: np.ndarray, seed: int) -> tuple[cc.SensorLog, np.ndarray]:
    """Return a log with the errors above, and the true attitude (n, 4)."""
    random = np.random.default_rng(seed)
    n = len(rate)
    t = STEP * np.arange(n)
    q = cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], STEP)
    bias = 1.0 * cc.DEG_PER_HOUR + np.cumsum(
        RRW * np.sqrt(STEP) * random.standard_normal((n, 3)), axis=0
    )
    measured = rate @ (np.eye(3) + GYRO).T + bias
    measured += ARW / np.sqrt(STEP) * random.standard_normal((n, 3))

    def fixes(turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        seen = cc.quaternion.multiply(q[::5], cc.quaternion.exp(turned))
        noise = cc.quaternion.exp(SIGMA * random.standard_normal((len(seen), 3)))
        return t[::5], cc.quaternion.multiply(seen, noise)

    return cc.SensorLog(gyro=(t, measured), star_1=fixes(np.zeros(3)), star_2=fixes(TURNED)), q


def rms(nav: cc.StarGyroNavigator, log: cc.SensorLog, q: np.ndarray) -> np.ndarray:
    """Return the attitude error per axis, rms in arcsec, after the first minute."""
    sol = nav.run(log)
    error = cc.quaternion.log(cc.quaternion.multiply(cc.quaternion.conjugate(sol.q), q))
    return np.sqrt(np.mean(error[sol.t > 60.0] ** 2, axis=0)) / cc.ARCSEC


def main() -> None:
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(arw=ARW, rrw=RRW), cc.StarCamera(sigma=SIGMA))

    # slews about x alone: what y and z would show stays at its prior, and the table says so
    log, _ = simulate(slews("xx"), seed=1)
    print("slews about x only")
    print(nav.calibrate(log))

    log, q = simulate(slews("xyz"), seed=2)
    found = nav.calibrate(log)
    print("\nslews about x, y and z")
    print(found)
    print("\n(I + M) is off by", np.abs(found.matrix - GYRO).max().round(6))

    # another day: the navigator that knows the errors against the one that does not
    log, q = simulate(slews("yxz"), seed=3)
    print(f"attitude as it was: {rms(nav, log, q).round(2)} arcsec rms")
    print(f"calibrated:         {rms(found.navigator, log, q).round(2)} arcsec rms")


if __name__ == "__main__":
    main()
