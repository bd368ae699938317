"""The filters against textbook filters in plain numpy, on a log that leaves nothing out.

The log has uneven steps of up to 0.3 rad, two cameras with mountings and full noise matrices, a
direction sensor, all at their own times between the gyro samples.
"""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from reference import Belief, Mekf, PlainUkf, Run, replay
from scipy.spatial.transform import Rotation
from simulate import FloatArray, changing_rate, exp, local, multiply

CAMERAS = {
    name: cc.StarCamera(mounting=Rotation.from_rotvec(v).as_quat()[[3, 0, 1, 2]])
    for name, v in (("star", [0.4, -1.0, 2.0]), ("star_2", [-2.0, 0.1, 0.5]))
}


def make_log(
    steps: int, noise: float, arw: float, rrw: float, seed: int
) -> tuple[cc.SensorLog, Belief]:
    """Return a log and where to start; `noise` is the size of the measurements' [rad]."""
    rng = np.random.default_rng(seed)
    dt = rng.uniform(0.2, 1.0, steps)
    t = np.concatenate([[0.0], np.cumsum(dt)])
    rate = changing_rate(steps + 1, 0.3)
    bias = 1e-3 * rng.standard_normal(3) + np.cumsum(
        rrw * np.sqrt(0.6) * rng.standard_normal((steps + 1, 3)), axis=0
    )
    q = np.empty((steps + 1, 4))
    q[0] = Rotation.random(random_state=rng).as_quat()
    jitter = arw * np.sqrt(dt)[:, None] * rng.standard_normal((steps, 3))
    for k in range(steps):
        q[k + 1] = multiply(q[k], exp(rate[k] * dt[k] + jitter[k]))
        q[k + 1] /= np.linalg.norm(q[k + 1])

    def truth_at(part: float, rows: slice) -> tuple[FloatArray, FloatArray]:
        step = dt[rows] * part
        return t[:-1][rows] + step, multiply(q[:-1][rows], exp(rate[:-1][rows] * step[:, None]))

    def fixes(name: str, part: float, rows: slice) -> tuple[FloatArray, FloatArray, FloatArray]:
        at, now = truth_at(part, rows)
        axes = Rotation.random(len(at), random_state=rng).as_matrix()
        root = axes * noise * [0.5, 1.0, 3.0]
        error = (root @ rng.standard_normal((len(at), 3, 1)))[..., 0]
        seen = multiply(multiply(now, np.asarray(CAMERAS[name].mounting)), exp(error))
        return at, seen, root @ root.swapaxes(1, 2)

    at, now = truth_at(0.3, slice(1, None, 3))
    inertial = np.array([0.6, -0.48, 0.64])
    seen = Rotation.from_quat(now[:, [1, 2, 3, 0]]).inv().apply(inertial)
    seen = Rotation.from_rotvec(noise * rng.standard_normal(seen.shape)).apply(seen)
    log = cc.SensorLog(
        gyro=(t, rate + bias),
        star=fixes("star", 0.0, slice(3, None, 4)),
        star_2=fixes("star_2", 0.7, slice(2, None, 5)),
        vector_sun=(at, seen, np.tile(inertial, (len(at), 1)), np.full(len(at), noise)),
    )
    # the start misses the truth, as the filter is told
    sigma = np.repeat([20.0 * noise, 2e-3], 3)
    error = sigma * rng.standard_normal(6)
    first = Belief(multiply(q[0], exp(error[:3])), error[3:], np.diag(sigma**2))
    return log, first


def run_plain(plain: Mekf | PlainUkf, log: cc.SensorLog, start: Belief) -> Run:
    return replay(plain, log, start, CAMERAS)


def compare(
    filter: cc.EKF | cc.UKF,  # noqa: A002
    gyro: cc.Gyro,
    log: cc.SensorLog,
    start: Belief,
    run: Run,
) -> tuple[float, float, float]:
    """Return the largest differences: attitude [rad], bias [rad/s], covariance (in its sigmas)."""
    sigma = np.sqrt(np.diag(start.p))
    sol = cc.StarGyroNavigator(filter, gyro, CAMERAS).run(
        log, t0=0.0, q0=start.q, bias0=start.bias, sigma0=(sigma[:3], sigma[3:]), covariance=True
    )
    assert sol.covariance is not None
    scale = np.sqrt(np.diagonal(run.covariance, axis1=1, axis2=2))
    p = (sol.covariance - run.covariance) / (scale[:, :, None] * scale[:, None, :])
    attitude = float(np.abs(local(run.q, sol.q)).max())
    bias = float(np.abs(run.bias - sol.bias).max())
    np.testing.assert_allclose(sol.nis, run.nis, rtol=1e-5)
    print(f"{filter}: {attitude:.1e} rad, {bias:.1e} rad/s, P {np.abs(p).max():.1e}")
    return attitude, bias, float(np.abs(p).max())


def test_ekf_is_the_textbook_mekf() -> None:
    log, start = make_log(400, 5e-5, 1e-5, 1e-6, seed=1)
    run = run_plain(Mekf(1e-5, 1e-6), log, start)
    attitude, bias, covariance = compare(cc.EKF(), cc.Gyro(1e-5, 1e-6), log, start, run)
    assert attitude < 1e-9
    assert bias < 1e-9
    assert covariance < 1e-7


@pytest.mark.parametrize(
    ("alpha", "beta", "kappa"),
    [(1.0, 2.0, -3.0), (1.0, 2.0, 0.0), (0.5, 0.3, 1.0), (0.1, 2.0, -3.0), (1e-3, 2.0, 0.0)],
)
def test_ukf_is_the_textbook_ukf(alpha: float, beta: float, kappa: float) -> None:
    """On data so coarse, errors of degrees, that the unscented transform is far from linear.

    With alpha = 1e-3 the points stand so close that the rounding of a quaternion, 1e-16, divided by
    the square of their distance, 6e-6, is 2e-11 rad in every step: two correct programs differ by
    that, some steps' worth of it, and no more can be asked.

    `SRUKF` draws its points along another square root, not a triangular one after a reset, so on
    such data it differs from `UKF` in the terms of fourth order; on fine data there are none.
    """
    log, start = make_log(120, 1e-2, 1e-3, 1e-4, seed=2)
    gyro = cc.Gyro(1e-3, 1e-4)
    run = run_plain(PlainUkf(1e-3, 1e-4, alpha, beta, kappa), log, start)
    rounding = 1e-10 if alpha > 0.01 else 1e-8
    attitude, bias, covariance = compare(cc.UKF(alpha, beta, kappa), gyro, log, start, run)
    assert attitude < rounding
    assert bias < rounding
    assert covariance < max(rounding, 1e-10)
    attitude, bias, covariance = compare(cc.SRUKF(alpha, beta, kappa), gyro, log, start, run)
    assert attitude < 1e-7
    assert bias < 1e-7
    assert covariance < 1e-5


def test_square_root_ukf_is_the_textbook_ukf_on_fine_data() -> None:
    log, start = make_log(120, 1e-4, 1e-5, 1e-6, seed=3)
    run = run_plain(PlainUkf(1e-5, 1e-6, 1.0, 2.0, -3.0), log, start)
    attitude, bias, covariance = compare(cc.SRUKF(), cc.Gyro(1e-5, 1e-6), log, start, run)
    assert attitude < 1e-10
    assert bias < 1e-10
    assert covariance < 1e-7
