"""The calibration filter on slews with known errors: right within what it says, and worth it."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from measure import bounds, quadratic
from scipy.spatial.transform import Rotation
from simulate import FloatArray, discretise, exp, multiply

RUNS = 48
SEED = 777
DT = 0.5
ARW, RRW, SIGMA = 1e-6, 1e-8, 1e-5
PRIOR = {"scale_sigma": 2e-3, "misalignment_sigma": 1e-3, "alignment_sigma": 3e-4}
SIGMA0 = (1e-4, 1e-4)
AT = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
NAMES = [
    "scale_x scale_y scale_z",
    "misalignment_xy misalignment_xz misalignment_yx",
    "misalignment_yz misalignment_zx misalignment_zy",
    "alignment_x alignment_y alignment_z",
]
PARAMETERS = " ".join(NAMES).split()
MOUNTING = Rotation.from_rotvec([0.0, 1.2, 0.4])


def slews(n: int) -> FloatArray:
    """Rates (n, 3): there and back about each axis in turn, up to half a degree a second."""
    k = np.arange(n)
    rate = np.zeros((n, 3))
    rate[k, k // 120 % 3] = 0.5 * cc.DEG * np.sin(2.0 * np.pi * (k % 120) / 120.0)
    rate[:, 1] -= 1.1e-3  # orbit rate
    return rate


def earth_pointing(n: int) -> FloatArray:
    return np.tile([0.0, -1.1e-3, 0.0], (n, 1))


class Flight:
    """One trial: the true rate is what the gyro reads, ``(I + M) rate + bias + noise``, says."""

    def __init__(self, rate: FloatArray, seed: int) -> None:
        rng = np.random.default_rng(seed)
        n = len(rate)
        spread = np.repeat([2e-3, 1e-3, 3e-4], [3, 6, 3])
        self.errors = spread * rng.standard_normal(12)
        self.matrix = np.zeros((3, 3))
        for at, value in zip(AT, self.errors[:9], strict=True):
            self.matrix[at] = value
        _, noise = discretise(np.zeros(3), DT, ARW, RRW)
        scale = np.sqrt(np.diag(noise))
        root = np.linalg.cholesky(noise / np.outer(scale, scale)) * scale[:, None]
        drawn = rng.standard_normal((n - 1, 6)) @ root.T
        self.t = DT * np.arange(n)
        self.bias = SIGMA0[1] * rng.standard_normal(3) + np.vstack(
            [np.zeros(3), np.cumsum(drawn[:, 3:], axis=0)]
        )
        # the noise in the rate's own axes, as the filter has it, is on the true side of I + M
        turned = multiply(exp(rate[:-1] * DT), exp(drawn[:, :3]))
        q = [Rotation.random(random_state=rng).as_quat()]
        for turn in turned:
            step = multiply(q[-1], turn)
            q.append(step / np.linalg.norm(step))
        self.q = np.array(q)
        self.rate = rate @ (np.eye(3) + self.matrix).T + self.bias
        first = SIGMA0[0] * rng.standard_normal(3)
        self.q0 = multiply(self.q[0], exp(-first))
        one = multiply(self.q[::4], exp(self._noise(rng, len(self.q[::4]))))
        # the second camera's fixes of the body are turned by the alignment
        two = multiply(self.q[2::4], exp(self.errors[9:]))
        two = multiply(two, exp(self._noise(rng, len(two))))
        q_bc = MOUNTING.as_quat()[[3, 0, 1, 2]]
        self.log = cc.SensorLog(
            gyro=(self.t, self.rate),
            star_1=(self.t[::4], one),
            star_2=(self.t[2::4], multiply(two, q_bc)),
        )

    @staticmethod
    def _noise(rng: np.random.Generator, n: int) -> FloatArray:
        return SIGMA * rng.standard_normal((n, 3))

    @property
    def start(self) -> dict[str, Any]:
        return {"q0": self.q0, "sigma0": SIGMA0}


def navigator(**errors: Any) -> cc.StarGyroNavigator:
    cameras = {"star_1": cc.StarCamera(SIGMA), "star_2": cc.StarCamera(SIGMA, mounting=MOUNTING)}
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(ARW, RRW, **errors), cameras)


@lru_cache
def flight(trial: int) -> Flight:
    return Flight(slews(2400), SEED + trial)


@lru_cache
def found(trial: int) -> cc.Calibration:
    f = flight(trial)
    return navigator().calibrate(f.log, **PRIOR, **f.start)


def test_parameters_are_found_within_their_sigmas() -> None:
    ratio = []
    for trial in range(RUNS):
        got, true = found(trial), dict(zip(PARAMETERS, flight(trial).errors, strict=True))
        assert list(got.value) == PARAMETERS
        ratio.append([(true[n] - got.value[n]) / got.sigma[n] for n in PARAMETERS])
        assert all(got.observable.values())
        assert max(got.ratio.values()) < 0.1, str(got)
    rms = np.sqrt(np.mean(np.square(ratio), axis=0))
    print("rms in sigmas", dict(zip(PARAMETERS, rms.round(2).tolist(), strict=True)))
    assert np.abs(ratio).max() < 3.5
    assert rms.max() < 1.7


def test_parameters_are_consistent() -> None:
    """NEES of the twelve, correlations and all, and of all eighteen."""
    errors = []
    for trial in range(RUNS):
        got, f = found(trial), flight(trial)
        value = np.array(list(got.value.values()))
        turn = Rotation.from_quat(got.solution.final["q"][[1, 2, 3, 0]]).inv()
        true = Rotation.from_quat(f.q[-1][[1, 2, 3, 0]])
        bias = f.bias[-1] - got.solution.final["bias"]
        errors.append(np.concatenate([(turn * true).as_rotvec(), bias, f.errors - value]))
    p = np.array([found(trial).covariance for trial in range(RUNS)])
    e = np.array(errors)
    for rows in (slice(6, 18), slice(0, 18), slice(6, 15), slice(15, 18)):
        dof = rows.stop - rows.start
        nees = quadratic(e[:, rows], p[:, rows, rows])
        within = bounds(0.999, dof, RUNS)
        print(f"NEES of {dof}: {nees.mean():.2f} in {within[0]:.2f} .. {within[1]:.2f}")
        assert within[0] < nees.mean() < within[1]


def test_without_slews_the_log_shows_little() -> None:
    """Earth pointing: only what a rate about y drives, and that only beside the bias."""
    f = Flight(earth_pointing(2400), SEED)
    got = navigator().calibrate(f.log, **PRIOR, **f.start)
    print(got)
    about_y = {"scale_y", "misalignment_xy", "misalignment_zy"}
    for name in set(PARAMETERS[:9]) - about_y:
        assert got.ratio[name] > 0.99, name
        assert not got.observable[name]
    for name in about_y:
        assert got.ratio[name] > 0.5, name  # a constant rate looks like a bias
    for name in PARAMETERS[9:]:
        assert got.ratio[name] < 0.1, name  # both cameras see the sky
    assert str(got).count("not observable") == sum(not v for v in got.observable.values())
    value = np.array([got.value[n] / got.prior_sigma[n] for n in set(PARAMETERS[:9]) - about_y])
    assert np.abs(value).max() < 0.2  # and stay at their prior


def test_the_corrected_navigator_beats_the_other() -> None:
    """On another flight with the same errors, over every row and in what it says of itself."""
    ratios, nis = [], []
    for trial in range(6):
        f = flight(trial)
        log, q = f.log, f.q
        errors = []
        for nav in (navigator(), found(trial).navigator):
            sol = nav.run(log, **f.start)
            turn = Rotation.from_quat(sol.q[:, [1, 2, 3, 0]]).inv()
            off = (turn * Rotation.from_quat(q[:, [1, 2, 3, 0]])).as_rotvec()[240:]
            errors.append(np.sqrt(np.mean(off**2)))
            nis.append(sol.nis.mean())
        ratios.append(errors[1] / errors[0])
    print("rms with over without", np.round(ratios, 3), "NIS", np.round(nis, 1))
    assert max(ratios) < 0.3
    assert np.all(np.array(nis[1::2]) < 3.3)
    assert np.all(np.array(nis[::2]) > 10.0)


def test_calibrating_twice_finds_nothing_more() -> None:
    """The corrected navigator holds the true matrix: (I + E)(I + M), mountings and all."""
    f = flight(0)
    once = found(0)
    again = once.navigator.calibrate(f.log, **PRIOR, **f.start)
    for name in PARAMETERS:
        assert abs(again.value[name]) < 0.5 * again.sigma[name], name
    corrected = np.asarray(again.navigator.gyro.errors)
    sigma = np.reshape([once.sigma[n] for n in PARAMETERS[:9]], 9)
    off = np.array([corrected[at] for at in AT]) - f.errors[:9]
    assert np.abs(off / sigma).max() < 3.5
    camera = again.navigator.star["star_2"]
    wanted = Rotation.from_rotvec(f.errors[9:]) * MOUNTING
    is_now = Rotation.from_quat(np.asarray(camera.mounting)[[1, 2, 3, 0]])
    off = (wanted.inv() * is_now).magnitude()
    assert off < 3.5 * max(once.sigma[n] for n in PARAMETERS[9:])


def test_matrix_is_that_of_the_gyros_equation() -> None:
    """Which entry is which: the matrix itself comes out, not its transpose."""
    true, matrix = flight(3).matrix, found(3).matrix
    assert np.abs(matrix - true).max() < 0.1 * np.abs(true - true.T).max()


@pytest.mark.parametrize("errors", [0.02, 0.05])
def test_large_errors_are_found_too(errors: float) -> None:
    f = Flight(slews(2400), SEED)
    matrix = errors / np.abs(f.matrix).max() * f.matrix
    true = (f.rate - f.bias) @ np.linalg.inv(np.eye(3) + f.matrix).T
    rate = true @ (np.eye(3) + matrix).T + f.bias
    log = cc.SensorLog(gyro=(f.t, rate), star_1=f.log.stars["star_1"])
    wide = {"scale_sigma": errors, "misalignment_sigma": errors}
    got = navigator().calibrate(log, **wide, **f.start)
    assert got.aligned is None
    off = np.array([got.matrix[at] - matrix[at] for at in AT])
    sigma = np.array([got.sigma[n] for n in PARAMETERS[:9]])
    print(np.round(off / sigma, 2))
    assert np.abs(off / sigma).max() < 3.5
