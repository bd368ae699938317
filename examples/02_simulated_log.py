"""Make gyro and star data with known truth, run two filters, and see whether errors fit sigmas."""

from __future__ import annotations

import celestcore as cc
import numpy as np

ARW, RRW = 1.5e-6, 3e-9  # rad/sqrt(s), rad/s/sqrt(s)
SIGMA = 5 * cc.ARCSEC  # of a star fix, per axis
STEP, LENGTH = 0.1, 1200.0  # s; the camera gives a fix every second


def simulate(seed: int) -> tuple[cc.SensorLog, np.ndarray, np.ndarray]:
    """Return a log, the true attitude (n, 4) and the true bias (n, 3)."""
    random = np.random.default_rng(seed)
    t = STEP * np.arange(int(LENGTH / STEP) + 1)
    n = len(t)
    phase = np.array([0.0, 1.0, 2.0])
    rate = 3e-3 * np.sin(2 * np.pi * t[:, None] / np.array([300.0, 400.0, 500.0]) + phase)

    q = cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], STEP)  # each rate holds

    walk = RRW * np.sqrt(STEP) * random.standard_normal((n, 3))
    bias = 1.0 * cc.DEG_PER_HOUR + np.cumsum(walk, axis=0)
    measured = rate + bias + ARW / np.sqrt(STEP) * random.standard_normal((n, 3))

    seen = slice(0, None, 10)
    noise = cc.quaternion.exp(SIGMA * random.standard_normal((len(t[seen]), 3)))
    fixes = cc.quaternion.multiply(q[seen], noise)
    return cc.SensorLog(gyro=(t, measured), star=(t[seen], fixes)), q, bias


def main() -> None:
    log, q_true, bias_true = simulate(seed=1)
    for kind in (cc.EKF(), cc.UKF()):
        nav = cc.StarGyroNavigator(
            filter=kind, gyro=cc.Gyro(arw=ARW, rrw=RRW), star=cc.StarCamera(sigma=SIGMA)
        )
        sol = nav.run(log, covariance=True)

        # the attitude error is a small rotation on the right, in the body frame
        turn = cc.quaternion.log(cc.quaternion.multiply(cc.quaternion.conjugate(sol.q), q_true))
        error = np.concatenate([turn, bias_true - sol.bias], axis=1)
        nees = np.einsum(
            "ni,ni->n", error, np.linalg.solve(sol.covariance, error[..., None])[..., 0]
        )

        settled = sol.t > 300.0
        rms = np.sqrt(np.mean(error[settled] ** 2, axis=0))
        inside = np.mean(np.abs(error[settled]) < 3 * sol.sigma[settled])
        print(f"{type(kind).__name__}: attitude {(rms[:3] / cc.ARCSEC).round(3)} arcsec rms,")
        print(f"  bias {(rms[3:] / cc.DEG_PER_HOUR).round(4)} deg/h rms,")
        print(f"  {inside:.1%} inside 3 sigma, NEES {nees[settled].mean():.1f} (about 6 expected)")


if __name__ == "__main__":
    main()
