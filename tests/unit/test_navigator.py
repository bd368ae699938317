"""StarGyroNavigator.run: outputs, sensors, timing, gaps, gates, starts, and how it behaves."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
SIGMA = 10 * cc.ARCSEC
ARW, RRW = 1e-6, 1e-8
GYRO, CAMERA = cc.Gyro(ARW, RRW), cc.StarCamera(SIGMA)
FILTERS = {"ekf": cc.EKF(), "ukf": cc.UKF(), "srukf": cc.SRUKF()}
PER_ROW = ("t", "q", "rate", "bias", "sigma")
PER_FIX = ("measurement_t", "sensor", "nis", "dof", "accepted", "innovation", "innovation_sigma")
every_filter = pytest.mark.parametrize("name", FILTERS)


@dataclass
class Truth:
    """A gyro whose rates hold between its samples, and the attitude that follows from them."""

    n: int = 400
    dt: float = 0.125
    seed: int = 0
    noisy: bool = True
    t: Array = field(init=False)
    rate: Array = field(init=False)
    measured: Array = field(init=False)
    bias: Array = field(init=False)
    q: Array = field(init=False)

    def __post_init__(self) -> None:
        self.rng = np.random.default_rng(self.seed)
        self.t = self.dt * np.arange(self.n)
        phase = 0.3 * self.t[:, None] + [0.0, 1.0, 2.0]
        self.rate = 0.05 * np.sin(phase) + [0.01, 0.0, 0.02]
        steps = np.r_[[[2e-5, -1e-5, 3e-5]], RRW * self.dt**0.5 * self.noise(self.n - 1, 3)]
        self.bias = np.cumsum(steps, axis=0)
        self.measured = self.rate + self.bias + ARW / self.dt**0.5 * self.noise(self.n, 3)
        self.q = quat.propagate(quat.exp([0.3, -0.5, 0.8]), self.rate[:-1], self.dt)

    def noise(self, *shape: int) -> Array:
        return self.rng.normal(size=shape) * self.noisy

    def at(self, t: Array) -> Array:
        """Attitude at any times."""
        k = np.searchsorted(self.t, t, side="right") - 1
        turned = quat.exp(self.rate[k] * (t - self.t[k])[:, None])
        return quat.multiply(self.q[k], turned)

    def fixes(self, t: Array, sigma: Any = SIGMA) -> Array:
        return quat.multiply(self.at(t), quat.exp(sigma * self.noise(len(t), 3)))

    def log(self, each: int = 2, **tables: Any) -> cc.SensorLog:
        given: dict[str, Any] = {"gyro": (self.t, self.measured)}
        if each:
            t = self.t[::each]
            given["star"] = (t, self.fixes(t))
        return cc.SensorLog(**{**given, **tables})


def navigator(filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, **{"gyro": GYRO, "star": CAMERA, **options})


def same_bits(a: cc.Solution, b: cc.Solution, names: tuple[str, ...]) -> None:
    for name in names:
        assert np.array_equal(getattr(a, name), getattr(b, name), equal_nan=True), name


def same_end(a: cc.Solution, b: cc.Solution) -> None:
    for name in ("t", "q", "bias", "sigma", "covariance"):
        assert np.array_equal(a.final[name], b.final[name]), name


def close(a: cc.Solution, b: cc.Solution, tolerance: float = 1e-12) -> None:
    """Attitudes and biases agree absolutely, sigmas relatively."""
    assert np.array_equal(a.t, b.t)
    assert quat.angle_between(a.q, b.q).max() < tolerance
    assert np.abs(a.bias - b.bias).max() < tolerance
    assert np.abs(a.sigma / b.sigma - 1.0).max() < 1e3 * tolerance


def errors(sol: cc.Solution, truth: Truth) -> Array:
    return quat.angle_between(sol.q, truth.at(sol.t))


# what is written, and when


@every_filter
@pytest.mark.parametrize("every", [1, 2, 3, 7, 399, 1000])
def test_every(name: str, every: int) -> None:
    truth = Truth()
    log = truth.log(star=(truth.t[5::3] + 0.01, truth.fixes(truth.t[5::3] + 0.01)))
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    nav = navigator(FILTERS[name])
    full, part = nav.run(log, **start), nav.run(log, every=every, covariance=True, **start)
    assert np.array_equal(full.t, truth.t)
    for column in PER_ROW:
        assert np.array_equal(getattr(part, column), getattr(full, column)[::every]), column
    same_bits(full, part, PER_FIX)
    same_end(full, part)


@every_filter
@pytest.mark.parametrize("period", [0.125, 0.375, 1.0, 0.03125, 0.05, 7.77, 1e3])
def test_period_does_not_disturb_the_filter(name: str, period: float) -> None:
    truth = Truth()
    t = np.sort(truth.rng.uniform(-1.0, truth.t[-1] + 1.0, 300))
    inside = (t >= 0) & (t <= truth.t[-1])
    log = truth.log(star=(t, truth.fixes(np.clip(t, 0.0, truth.t[-1]))))
    nav = navigator(FILTERS[name])
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    full, part = nav.run(log, **start), nav.run(log, period=period, covariance=True, **start)
    same_bits(full, part, PER_FIX)
    same_end(full, part)
    assert len(part.measurement_t) == inside.sum()
    rows = int(np.floor(truth.t[-1] / period)) + 1
    assert np.array_equal(part.t, period * np.arange(rows))
    both, i, j = np.intersect1d(full.t, part.t, return_indices=True)
    assert len(both) >= 1
    assert quat.angle_between(full.q[i], part.q[j]).max() < 1e-12
    for column in ("bias", "sigma"):
        assert np.abs(getattr(full, column)[i] - getattr(part, column)[j]).max() < 1e-12, column


def test_rows_between_samples_are_predictions() -> None:
    truth = Truth(noisy=False)
    log = truth.log(each=0)
    nav = navigator(gyro=cc.Gyro(ARW, RRW))
    sol = nav.run(log, q0=truth.q[0], sigma0=(1e-9, 1e-9), bias0=truth.bias[0], period=0.05)
    assert errors(sol, truth).max() < 1e-12
    assert np.all(np.diff(sol.sigma[:, :3], axis=0) > 0.0)


@pytest.mark.parametrize("sampling", ["hold", "integrated", "average"])
def test_rate_of_a_row_is_that_of_its_time(sampling: str) -> None:
    truth = Truth()
    log = truth.log(each=0)
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    start = {"q0": truth.q[0], "sigma0": (1e-9, 1e-9)}
    full, part = nav.run(log, **start), nav.run(log, period=0.0625, **start)
    assert np.array_equal(full.rate, truth.measured)
    before, after = truth.measured[:-1], truth.measured[1:]
    step = {"hold": before, "integrated": after, "average": 0.5 * (before + after)}
    assert np.array_equal(part.rate[1::2], step[sampling])  # between two samples
    assert np.array_equal(part.rate[::2], truth.measured)  # at a sample, as with every=1


@settings(max_examples=150, deadline=None)
@given(
    first=st.floats(-1e6, 1e6),
    dt=st.floats(1e-3, 10.0),
    n=st.integers(1, 40),
    period=st.floats(1e-2, 1e2),
    late=st.floats(0.0, 1.0),
)
def test_period_rows_are_all_written(
    first: float, dt: float, n: int, period: float, late: float
) -> None:
    t = first + dt * np.arange(n)
    log = cc.SensorLog(gyro=(t, np.zeros((n, 3))))
    t0 = first + late * (t[-1] - first)
    sol = navigator().run(
        log, q0=[1.0, 0.0, 0.0, 0.0], sigma0=(1.0, 1.0), t0=t0, period=dt * period
    )
    assert np.array_equal(sol.t, t0 + dt * period * np.arange(len(sol)))
    assert sol.t[-1] <= t[-1] < t0 + dt * period * len(sol)
    assert np.all(sol.sigma > 0.0)
    assert np.array_equal(sol.q, np.tile([1.0, 0.0, 0.0, 0.0], (len(sol), 1)))


@settings(max_examples=150, deadline=None)
@given(n=st.integers(1, 40), every=st.integers(1, 50), late=st.floats(0.0, 1.0))
def test_every_rows_are_all_written(n: int, every: int, late: float) -> None:
    t = np.arange(float(n))
    log = cc.SensorLog(gyro=(t, np.zeros((n, 3))), star=(t, np.tile([1.0, 0, 0, 0], (n, 1))))
    t0 = late * t[-1]
    sol = navigator().run(log, q0=[1.0, 0, 0, 0], sigma0=(1.0, 1.0), t0=t0, every=every)
    assert np.array_equal(sol.t, [t0, *t[int(t0) :: every][1:]])
    assert np.all(sol.sigma > 0.0)
    assert np.array_equal(sol.measurement_t, t[t >= t0])
    assert np.all(sol.innovation_sigma > 0.0)


def test_columns_of_a_run() -> None:
    truth = Truth()
    star_t = truth.t[::2]
    log = truth.log(epoch="2026-01-01T00:00:00", title="made up", frames={"body": "bus"})
    sol = navigator(cc.UKF(), gate=0.9).run(log)
    n, m = truth.n, len(star_t) - 1
    shapes = {"t": (n,), "q": (n, 4), "rate": (n, 3), "bias": (n, 3), "sigma": (n, 6)}
    shapes |= {"measurement_t": (m,), "sensor": (m,), "nis": (m,), "dof": (m,), "accepted": (m,)}
    shapes |= {"innovation": (m, 3), "innovation_sigma": (m, 3), "gaps": (0, 2)}
    for name, shape in shapes.items():
        assert getattr(sol, name).shape == shape, name
    assert sol.covariance is None
    assert (sol.epoch, sol.title, sol.filter) == ("2026-01-01T00:00:00", "made up", "ukf")
    assert sol.frames["body"] == "bus"
    assert sol.sensor_names == ["star"]
    assert np.array_equal(sol.measurement_t, star_t[1:])
    assert np.all(sol.dof == 3)
    assert np.abs(np.linalg.norm(sol.q, axis=1) - 1.0).max() < 1e-14
    assert np.array_equal(sol.rate, truth.measured - sol.bias)
    assert sol.elapsed_s > 0.0
    counts = sol.counts
    assert counts["samples"] == n
    assert counts["fixes"] == m + 1
    assert counts["start"] == 1
    assert counts["accepted"] + counts["rejected"] == m
    assert counts["rejected"] == np.count_nonzero(~sol.accepted) > 0


@every_filter
def test_covariance(name: str) -> None:
    truth = Truth()
    log, nav = truth.log(), navigator(FILTERS[name])
    sol, plain = nav.run(log, covariance=True), nav.run(log)
    same_bits(sol, plain, PER_ROW + PER_FIX)
    p = sol.covariance
    assert p is not None
    assert p.shape == (truth.n, 6, 6)
    assert np.abs(np.sqrt(np.diagonal(p, axis1=1, axis2=2)) / sol.sigma - 1.0).max() < 1e-12
    assert np.array_equal(p, p.transpose(0, 2, 1))
    scaled = p / (sol.sigma[:, :, None] * sol.sigma[:, None, :])
    assert np.linalg.eigvalsh(scaled).min() > 1e-6
    assert np.abs(scaled[-1] - np.eye(6)).max() > 0.01  # attitude and bias are correlated
    assert np.array_equal(p[-1], sol.final["covariance"])
    assert np.array_equal(sol.q[-1], sol.final["q"])
    assert sol.t[-1] == sol.final["t"]


@every_filter
def test_runs_give_the_same_bits(name: str) -> None:
    truth = Truth()
    t = truth.t[:-1:3] + 0.01
    log = truth.log(star_2=(t, truth.fixes(t)))
    for portable in (False, True):
        nav = navigator(FILTERS[name], gate=0.999)
        a = nav.run(log, covariance=True, portable=portable)
        b = nav.run(log, covariance=True, portable=portable)
        same_bits(a, b, (*PER_ROW, *PER_FIX, "covariance"))
        same_end(a, b)
    close(nav.run(log), nav.run(log, portable=True), 1e-11)


def test_filters_agree() -> None:
    truth = Truth(n=2000)
    log = truth.log(vector_sun=(truth.t[::5], *directions(truth, truth.t[::5], [0.0, 0.6, 0.8])))
    runs = [navigator(f, vector=cc.VectorSensor(1e-3)).run(log) for f in FILTERS.values()]
    for other in runs[1:]:
        late = runs[0].t > 20.0
        apart = quat.angle_between(runs[0].q, other.q)[late]
        assert np.all(apart < 1e-4 * runs[0].sigma[late, :3].min())
        relative = np.abs(other.bias - runs[0].bias)[late] / runs[0].sigma[late, 3:]
        assert relative.max() < 1e-3
        assert np.abs(other.sigma / runs[0].sigma - 1.0)[late].max() < 1e-5


def test_errors_are_as_predicted() -> None:
    ratios = []
    for seed in range(20):
        truth = Truth(n=1000, seed=seed)
        sol = navigator().run(truth.log())
        late = sol.t > 30.0
        dtheta = quat.log(quat.multiply(quat.conjugate(sol.q), truth.at(sol.t)))
        ratios.append((np.c_[dtheta, truth.bias - sol.bias] / sol.sigma)[late])
    rms = np.sqrt(np.mean(np.square(ratios), axis=(0, 1)))
    assert np.all((rms > 0.7) & (rms < 1.3))


def test_sign_of_q_is_continuous_over_several_turns() -> None:
    n = 2000
    t = 0.1 * np.arange(n)
    rate = np.tile([0.0, 0.3, 0.0], (n, 1))
    q = quat.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], 0.1)
    signs = np.where(np.random.default_rng(1).random(n) < 0.5, -1.0, 1.0)
    signs[0] = 1.0
    log = cc.SensorLog(gyro=(t, rate), star=(t, q * signs[:, None]))
    for kind in FILTERS.values():
        sol = navigator(kind).run(log)
        assert np.all(np.einsum("ni,ni->n", sol.q[1:], sol.q[:-1]) > 0.99)
        assert np.abs(sol.q - q).max() < 1e-6  # past a whole turn, q is on the other side
        assert sol.q[:, 0].min() < -0.99


def test_inputs_are_left_alone_and_outputs_are_fresh() -> None:
    truth = Truth()
    q0, bias0, sigma0 = truth.q[0].copy(), truth.bias[0].copy(), np.array([[1e-3] * 3, [1e-4] * 3])
    log = truth.log()
    before = [q0.copy(), bias0.copy(), sigma0.copy(), log.gyro.rate.copy()]
    sol = navigator().run(log, q0=q0, bias0=bias0, sigma0=sigma0)
    for was, now in zip(before, [q0, bias0, sigma0, log.gyro.rate], strict=True):
        assert np.array_equal(was, now)
    for name in PER_ROW + PER_FIX:
        column = getattr(sol, name)
        assert column.flags.c_contiguous
        assert column.flags.writeable
        assert not np.shares_memory(column, log.gyro.t)


# sensors and their mountings


def directions(truth: Truth, t: Array, inertial: Any, sigma: float = 1e-3) -> tuple[Array, Array]:
    """Noisy directions in the body frame, and what they are in the inertial frame."""
    i = np.broadcast_to(np.asarray(inertial), (len(t), 3))
    b = quat.rotate(quat.conjugate(truth.at(t)), i) + sigma * truth.noise(len(t), 3)
    return b / np.linalg.norm(b, axis=1, keepdims=True), i


def test_gyro_mounting() -> None:
    truth = Truth()
    mounting = Rotation.from_euler("xyz", [20, -70, 110], degrees=True)
    log = truth.log()
    turned = cc.SensorLog(
        gyro=(truth.t, mounting.inv().apply(truth.measured)), star=log.stars["star"]
    )
    plain = navigator().run(log)
    sol = navigator(gyro=cc.Gyro(ARW, RRW, mounting=mounting)).run(turned)
    close(sol, plain, 1e-13)
    assert np.abs(sol.bias[-1] - truth.bias[-1]).max() < 1e-5  # the bias is in the body frame
    wrong = navigator(gyro=cc.Gyro(ARW, RRW, mounting=mounting.inv())).run(turned)
    assert errors(wrong, truth)[-1] > 100 * errors(sol, truth)[-1]


@every_filter
def test_several_cameras_equal_one_in_the_body_frame(name: str) -> None:
    truth = Truth()
    mountings = {"star_1": [10, 80, -30], "star_2": [-100, 15, 60]}
    sigma = np.array([1.0, 2.0, 10.0]) * SIGMA
    tables, cameras, merged = {}, {}, []
    for k, (table, angles) in enumerate(mountings.items()):
        q_bc = Rotation.from_euler("zyx", angles, degrees=True)
        t = truth.t[k::4] + 0.02 * k
        q_ic = Rotation.from_quat(truth.at(t), scalar_first=True) * q_bc
        q_ic = q_ic * Rotation.from_rotvec(sigma * truth.noise(len(t), 3))
        tables[table] = (t, q_ic)
        own = cc.StarCamera(sigma, mounting=q_bc)
        cameras[table] = own
        noise = q_bc.as_matrix() @ np.diag(sigma**2) @ q_bc.as_matrix().T
        merged += list(zip(t, (q_ic * q_bc.inv()).as_quat(scalar_first=True), strict=True))
        tables[table + "_noise"] = noise
    noises = [tables.pop(table + "_noise") for table in mountings]
    log = truth.log(each=0, **tables)
    t, q = (np.array(x) for x in zip(*merged, strict=True))
    which = np.repeat([0, 1], [len(tables["star_1"][0]), len(tables["star_2"][0])])
    order = np.argsort(t, kind="stable")
    one = truth.log(star=(t[order], q[order], np.array(noises)[which[order]]))
    a = navigator(FILTERS[name], star=cameras).run(log)
    b = navigator(FILTERS[name], star=cc.StarCamera()).run(one)
    close(a, b, 1e-12)
    assert np.abs(a.nis - b.nis).max() < 1e-6
    assert a.sensor_names == ["star_1", "star_2"]
    assert np.array_equal(a.sensor, which[order][1:])
    assert errors(a, truth)[-1] < 3 * SIGMA


def test_two_cameras_see_what_one_does_not() -> None:
    truth = Truth()
    blunt = np.array([1.0, 1.0, 100.0]) * SIGMA
    side = Rotation.from_euler("y", 90, degrees=True)
    nav = navigator(
        star={"star_1": cc.StarCamera(blunt), "star_2": cc.StarCamera(blunt, mounting=side)}
    )
    first = {"star_1": (truth.t, truth.fixes(truth.t))}
    r = Rotation.from_quat(truth.fixes(truth.t), scalar_first=True) * side
    one = nav.run(truth.log(each=0, **first))
    both = nav.run(truth.log(each=0, **first, star_2=(truth.t, r)))
    assert one.final["sigma"][2] > 2 * both.final["sigma"][2]
    assert one.final["sigma"][1] < 2 * both.final["sigma"][1]


def test_one_camera_stands_for_all() -> None:
    truth = Truth()
    tables = {"star_1": (truth.t[::2], truth.fixes(truth.t[::2]))}
    tables["star_b"] = (truth.t[1::2], truth.fixes(truth.t[1::2]))
    log = truth.log(each=0, **tables)
    a = navigator().run(log)
    b = navigator(star={"star_b": CAMERA, "star_1": CAMERA, "unused": cc.StarCamera(0.4)}).run(log)
    same_bits(a, b, PER_ROW + PER_FIX)


@every_filter
def test_two_directions_determine_the_attitude(name: str) -> None:
    truth = Truth(n=1000)
    t = truth.t[1::2]
    tables = {"vector_sun": (t, *directions(truth, t, [1.0, 0.0, 0.0]))}
    tables["vector_mag"] = (t, *directions(truth, t, [0.0, 0.6, 0.8]))
    nav = navigator(FILTERS[name], vector=cc.VectorSensor(1e-3))
    start = {"q0": quat.multiply(truth.q[0], quat.exp([0.2, -0.1, 0.15])), "sigma0": (0.3, 1e-4)}
    sol = nav.run(truth.log(each=0, **tables), **start)
    assert np.all(sol.dof == 2)
    assert np.isnan(sol.innovation[:, 2]).all()
    assert np.isfinite(sol.innovation[:, :2]).all()
    assert np.isnan(sol.innovation_sigma[:, 2]).all()
    assert sol.final["sigma"][:3].max() < 2e-4
    assert errors(sol, truth)[-1] < 4 * np.linalg.norm(sol.final["sigma"][:3])
    assert sol.sensor_names == ["vector_sun", "vector_mag"]


def test_one_direction_leaves_the_turn_about_it_open() -> None:
    truth = Truth()
    i = np.array([0.0, 0.6, 0.8])
    log = truth.log(each=0, vector_sun=(truth.t, *directions(truth, truth.t, i)))
    nav = navigator(vector=cc.VectorSensor(1e-3))
    sol = nav.run(log, q0=truth.q[0], sigma0=(0.01, 1e-9), covariance=True)
    q, p = sol.final["q"], sol.final["covariance"][:3, :3]
    along = quat.rotate(quat.conjugate(q), i)
    across = np.linalg.svd(along[None])[2][1:]
    assert np.sqrt(along @ p @ along) == pytest.approx(0.01, rel=0.01)
    assert np.sqrt(np.diagonal(across @ p @ across.T)).max() < 2e-4


def test_vector_mounting_and_noise() -> None:
    truth = Truth()
    b, i = directions(truth, truth.t, [0.0, 0.6, 0.8])
    mounting = Rotation.from_euler("xyz", [10, -20, 130], degrees=True)
    plain = navigator(vector=cc.VectorSensor(1e-3)).run(truth.log(vector_a=(truth.t, b, i)))
    truth = Truth()
    directions(truth, truth.t, [0.0, 0.6, 0.8])
    turned = truth.log(vector_a=(truth.t, mounting.inv().apply(b), i))
    nav = navigator(vector={"a": cc.VectorSensor(1e-3, mounting=mounting)})
    close(nav.run(turned), plain, 1e-12)
    own = cc.SensorLog(
        gyro=turned.gyro,
        star=turned.stars["star"],
        vector_a=(truth.t, mounting.inv().apply(b), i, np.full(truth.n, 1e-3)),
    )
    blunt = navigator(vector={"a": cc.VectorSensor(0.3, mounting=mounting)})
    same_bits(blunt.run(own), nav.run(turned), PER_ROW + PER_FIX)  # the table's noise goes first


def test_noise_of_each_fix() -> None:
    truth = Truth()
    t, q = truth.t[::2], truth.fixes(truth.t[::2])
    sigma = SIGMA * truth.rng.uniform(0.5, 20.0, (len(t), 3))
    full = np.einsum("ni,ij->nij", sigma**2, np.eye(3))

    def run(camera: cc.StarCamera, *noise: Any) -> cc.Solution:
        return navigator(star=camera).run(truth.log(star=(t, q, *noise)))

    each = run(cc.StarCamera(), sigma)
    same_bits(each, run(cc.StarCamera(0.4), sigma), PER_ROW + PER_FIX)  # goes before the camera's
    close(each, run(cc.StarCamera(0.4), full), 1e-13)
    plain = run(CAMERA)
    same_bits(plain, run(cc.StarCamera(), np.full((len(t), 3), SIGMA)), PER_ROW + PER_FIX)
    assert np.abs(each.sigma / plain.sigma - 1.0).max() > 0.5


def test_update_weighs_as_information_does() -> None:
    truth = Truth(n=3)
    mounting = Rotation.from_euler("xyz", [30, 40, 50], degrees=True)
    r = np.array([[3.0, 1.0, 0.5], [1.0, 2.0, -0.3], [0.5, -0.3, 1.0]]) * SIGMA**2
    turn = mounting.as_matrix()
    p0 = np.diag([2.0, 3.0, 4.0]) * SIGMA**2
    q_ic = Rotation.from_quat(truth.q[0], scalar_first=True) * mounting
    dtheta = 1e-3 * SIGMA * np.array([0.5, -1.0, 2.0])  # small: no turn of the covariance
    q0 = quat.multiply(truth.q[0], quat.exp(-dtheta))
    log = cc.SensorLog(
        gyro=(truth.t, truth.measured), star=(truth.t[:1], [q_ic.as_quat(scalar_first=True)])
    )
    nav = navigator(star=cc.StarCamera(covariance=r, mounting=mounting))
    sol = nav.run(log, q0=q0, sigma0=(np.sqrt(np.diag(p0)), 1e-6), covariance=True)
    body = turn @ r @ turn.T
    gain = p0 @ np.linalg.inv(p0 + body)
    assert sol.covariance is not None
    expected = (np.eye(3) - gain) @ p0
    assert np.abs(sol.covariance[0, :3, :3] / SIGMA**2 - expected / SIGMA**2).max() < 1e-6
    moved = quat.log(quat.multiply(quat.conjugate(q0), sol.q[0]))
    assert np.abs(moved - gain @ dtheta).max() < 1e-9 * SIGMA
    assert np.abs(sol.innovation[0] - dtheta).max() < 1e-9 * SIGMA
    nis = dtheta @ np.linalg.inv(p0 + body) @ dtheta
    assert sol.nis[0] == pytest.approx(nis, rel=1e-6)
    assert sol.innovation_sigma[0] == pytest.approx(np.sqrt(np.diag(p0 + body)), rel=1e-9)


def test_bias_reaches_the_attitude_through_time() -> None:
    """At rest the covariance is known in closed form, however the time is cut."""
    rng = np.random.default_rng(3)
    t = np.r_[0.0, np.sort(rng.uniform(0.0, 100.0, 500)), 100.0]
    log = cc.SensorLog(gyro=(t, np.zeros((len(t), 3))))
    nav = navigator(gyro=cc.Gyro(1e-5, 1e-6, max_gap=1e3))
    sol = nav.run(log, q0=[1.0, 0, 0, 0], sigma0=(1e-4, 1e-5), covariance=True)
    p = sol.covariance
    assert p is not None
    attitude = 1e-4**2 + (1e-5 * t) ** 2 + 1e-5**2 * t + 1e-6**2 * t**3 / 3.0
    bias = 1e-5**2 + 1e-6**2 * t
    cross = -(1e-5**2 * t + 1e-6**2 * t**2 / 2.0)
    for k in range(3):
        assert np.allclose(p[:, k, k], attitude, rtol=1e-10)
        assert np.allclose(p[:, k + 3, k + 3], bias, rtol=1e-10)
        assert np.allclose(p[:, k, k + 3], cross, rtol=1e-10)


# time: fixes anywhere, steps of any length, what a sample means


@every_filter
def test_fix_between_samples_equals_a_split_step(name: str) -> None:
    truth = Truth()
    t = np.sort(truth.rng.choice(truth.t[1:-1], 100, replace=False)) + 0.037
    q = truth.fixes(t)
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    nav = navigator(FILTERS[name])
    sol = nav.run(truth.log(star=(t, q)), **start)
    k = np.searchsorted(truth.t, t, side="right") - 1
    split_t = np.insert(truth.t, k + 1, t)
    split_rate = np.insert(truth.measured, k + 1, truth.measured[k], axis=0)
    split = nav.run(cc.SensorLog(gyro=(split_t, split_rate), star=(t, q)), **start)
    kept = np.isin(split.t, truth.t)
    assert np.array_equal(sol.q, split.q[kept])
    assert np.array_equal(sol.sigma, split.sigma[kept])
    same_bits(sol, split, PER_FIX)


def test_fixes_at_equal_times_come_in_the_order_of_the_tables() -> None:
    truth = Truth()
    a, b = truth.fixes(truth.t), truth.fixes(truth.t)
    start = {"q0": truth.q[0], "sigma0": (1e-3, 1e-4)}
    sol = navigator().run(truth.log(each=0, star_1=(truth.t, a), star_2=(truth.t, b)), **start)
    assert np.array_equal(sol.sensor, np.tile([0, 1], truth.n))
    assert np.array_equal(sol.measurement_t, np.repeat(truth.t, 2))
    other = navigator().run(truth.log(each=0, star_2=(truth.t, b), star_1=(truth.t, a)), **start)
    assert other.sensor_names == ["star_2", "star_1"]
    assert not np.array_equal(sol.nis, other.nis)
    close(sol, other, 1e-10)


def test_output_at_a_sample_has_seen_the_fix_at_that_time() -> None:
    truth = Truth()
    log = truth.log(each=1)
    for output in ({"every": 1}, {"period": 0.125}):
        sol = navigator().run(log, q0=truth.q[0], sigma0=(1.0, 1e-4), **output)
        assert sol.sigma[0, :3].max() < 1.001 * SIGMA
        assert np.all(sol.sigma[:, :3] < 1.001 * SIGMA)


def test_fixes_outside_the_gyro_span_are_counted_and_not_used() -> None:
    truth = Truth()
    inside = truth.log()
    q = np.r_[inside.stars["star"].q[:3], inside.stars["star"].q, inside.stars["star"].q[:2]]
    t = np.r_[-3.0, -2.0, -1e-9, inside.stars["star"].t, truth.t[-1] + 1e-9, 1e3]
    log = truth.log(star=(t, q))
    a, b = navigator().run(inside), navigator().run(log)
    same_bits(a, b, PER_ROW + PER_FIX)
    same_end(a, b)
    assert (a.counts["outside"], b.counts["outside"]) == (0, 5)
    for sol in (a, b):
        c = sol.counts
        assert c["fixes"] == c["accepted"] + c["rejected"] + c["start"] + c["outside"]
    late = navigator().run(log, q0=truth.q[100], sigma0=(1e-3, 1e-4), t0=truth.t[100])
    assert late.counts["outside"] == 5 + 50
    assert late.measurement_t[0] == truth.t[100]
    last = navigator().run(truth.log(star=(truth.t[-1:], truth.q[-1:])))
    assert (len(last), last.counts["outside"]) == (1, 0)


def test_missing_rows_are_counted() -> None:
    truth = Truth()
    rate, q = truth.measured.copy(), truth.fixes(truth.t)
    rate[[5, 6]] = np.nan
    q[7, 2] = np.inf
    sol = navigator().run(cc.SensorLog(gyro=(truth.t, rate), star=(truth.t, q)))
    assert sol.counts["missing"] == 3
    assert sol.counts["samples"] == truth.n - 2
    assert sol.counts["fixes"] == truth.n - 1
    assert np.isfinite(sol.q).all()
    assert errors(sol, truth)[-1] < 5 * SIGMA


def steps_truth(sampling: str, seed: int) -> tuple[Array, Array, Array]:
    """Irregular steps; the rate of each is what the samples mean by it, exactly."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.01, 1.0, 500))
    rate = rng.normal(size=(500, 3)) * 0.1
    step = {"hold": rate[:-1], "integrated": rate[1:], "average": 0.5 * (rate[1:] + rate[:-1])}
    return t, rate, quat.propagate(quat.exp([0.1, 0.2, 0.3]), step[sampling], np.diff(t))


@every_filter
@pytest.mark.parametrize("truth", ["hold", "integrated", "average"])
def test_sampling(name: str, truth: str) -> None:
    t, rate, q = steps_truth(truth, 4)
    log = cc.SensorLog(gyro=(t, rate))
    for sampling in ("hold", "integrated", "average"):
        nav = navigator(FILTERS[name], gyro=cc.Gyro(1e-12, 0.0, sampling=sampling))
        sol = nav.run(log, q0=q[0], sigma0=(1e-9, 1e-12))
        error = quat.angle_between(sol.q, q)[1:]
        if sampling == truth:
            assert error.max() < 1e-12
        else:
            assert error.min() > 1e-4


@pytest.mark.parametrize("sampling", ["integrated", "average"])
def test_sampling_with_fixes_between_samples(sampling: str) -> None:
    """Within a step the rate is that of the step, on both sides of a fix."""
    t, rate, q = steps_truth(sampling, 5)
    part = np.random.default_rng(6).uniform(0.1, 0.9, len(t) - 1)
    fix_q = quat.slerp(q[:-1], q[1:], part)
    log = cc.SensorLog(gyro=(t, rate), star=(t[:-1] + part * np.diff(t), fix_q))
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    sol = nav.run(log, q0=q[0], sigma0=(1e-3, 1e-4))
    assert np.abs(sol.innovation).max() < 1e-11
    assert quat.angle_between(sol.q, q).max() < 1e-11


def test_average_suits_a_smooth_rate() -> None:
    fine = 0.1 * np.arange(10 * 300 + 1) / 10
    rate = 0.2 * np.sin(0.5 * fine[:, None] + [0.0, 1.0, 2.0])
    q = quat.propagate([1.0, 0, 0, 0], 0.5 * (rate[1:] + rate[:-1]), 0.01)[::10]
    log = cc.SensorLog(gyro=(fine[::10], rate[::10]))
    drift = {}
    for sampling in ("hold", "integrated", "average"):
        nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
        sol = nav.run(log, q0=[1.0, 0, 0, 0], sigma0=(1e-9, 1e-9))
        drift[sampling] = quat.angle_between(sol.q, q).max()
    assert drift["average"] < 2e-3
    assert min(drift["hold"], drift["integrated"]) > 10 * drift["average"], drift


# gaps


def gap_log(step: float, rate: Array | None = None) -> tuple[Array, cc.SensorLog]:
    t = np.r_[np.arange(0.0, 10.0), 9.0 + step + np.arange(0.0, 10.0)]
    return t, cc.SensorLog(gyro=(t, np.zeros((20, 3)) if rate is None else rate))


@every_filter
def test_gap_grows_the_covariance(name: str) -> None:
    _, log = gap_log(30.0)
    start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
    wide, flagged = (
        navigator(FILTERS[name], gyro=cc.Gyro(ARW, RRW, max_gap=gap, gap_rate_sigma=2e-4))
        for gap in (30.0, 29.9)
    )
    plain, sol = wide.run(log, **start), flagged.run(log, **start)
    assert plain.gaps.shape == (0, 2)
    assert plain.counts["gaps"] == 0
    assert np.array_equal(sol.gaps, [[9.0, 39.0]])
    assert sol.counts["gaps"] == 1
    grown = sol.sigma**2 - plain.sigma**2
    assert np.abs(grown[:10]).max() == 0.0
    assert np.allclose(grown[10:, :3], (2e-4 * 30.0) ** 2, rtol=1e-9)
    assert np.abs(grown[10:, 3:]).max() < 1e-25
    none = navigator(FILTERS[name], gyro=cc.Gyro(ARW, RRW, max_gap=1.0, gap_rate_sigma=0.0))
    still = none.run(log, **start)
    assert still.counts["gaps"] == 1
    assert np.array_equal(still.sigma, plain.sigma)


def test_gap_is_three_median_steps_unless_given() -> None:
    for step, gaps in ((3.0, 0), (3.001, 1)):
        _, log = gap_log(step)
        start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
        assert navigator().run(log, **start).counts["gaps"] == gaps


@pytest.mark.parametrize("sampling", ["hold", "integrated", "average"])
def test_rate_in_a_gap_is_the_mean_of_its_ends(sampling: str) -> None:
    rate = np.zeros((20, 3))
    rate[9], rate[10] = [0.01, 0.0, 0.0], [0.03, 0.0, 0.0]
    _, log = gap_log(30.0, rate)
    nav = navigator(gyro=cc.Gyro(ARW, RRW, sampling=sampling))
    sol = nav.run(log, q0=[1.0, 0, 0, 0], sigma0=(1e-4, 1e-9), period=1.0)
    inside = (sol.t > 9.0) & (sol.t < 39.0)
    assert inside.sum() == 29
    assert np.abs(sol.rate[inside] - [0.02, 0.0, 0.0]).max() < 1e-15
    before, after = sol.q[9], sol.q[39]
    turned = quat.angle_between(before, after)
    assert turned == pytest.approx(30.0 * 0.02, abs=1e-12)


def test_fixes_inside_a_gap_divide_it() -> None:
    """The unknown rate is a noise density in a gap: its parts add up to the whole."""
    _, log = gap_log(30.0)
    start = {"q0": [1.0, 0, 0, 0], "sigma0": (1e-4, 1e-9)}
    nav = navigator(gyro=cc.Gyro(ARW, RRW), star=cc.StarCamera(covariance=1e6 * np.eye(3)))
    plain = nav.run(log, **start)
    blind = cc.SensorLog(gyro=log.gyro, star=([12.0, 25.0], [[1.0, 0, 0, 0]] * 2))
    with_fixes = nav.run(blind, **start)  # fixes that tell nothing
    assert np.allclose(with_fixes.sigma, plain.sigma, rtol=1e-6)
    sharp = navigator(gyro=cc.Gyro(ARW, RRW)).run(blind, **start)
    expected = SIGMA**2 + 1e-3**2 * 30.0 * (39.0 - 25.0)
    assert np.allclose(sharp.sigma[10, :3] ** 2, expected, rtol=1e-3)


# the gate


def with_outliers(truth: Truth, rows: Any, size: float) -> cc.SensorLog:
    t = truth.t[::2]
    q = truth.fixes(t)
    bad = q.copy()
    bad[rows] = quat.multiply(q[rows], quat.exp(size * np.ones(3) / 3**0.5))
    return truth.log(star=(t, bad))


@every_filter
@pytest.mark.parametrize("size", [100 * SIGMA, 0.3, 3.1])
def test_outliers_are_rejected_and_change_nothing(name: str, size: float) -> None:
    truth = Truth()
    rows = np.array([40, 41, 42, 90, 150])
    log = with_outliers(truth, rows, size)
    sol = navigator(FILTERS[name], gate=0.999999).run(log, covariance=True)
    assert np.array_equal(np.flatnonzero(~sol.accepted), rows - 1)  # the first fix is the start
    assert sol.counts["rejected"] == 5
    assert np.all(sol.nis[rows - 1] > 30.0)
    star = log.stars["star"]
    kept = np.delete(np.arange(len(star)), rows)
    clean = navigator(FILTERS[name]).run(
        cc.SensorLog(gyro=log.gyro, star=(star.t[kept], star.q[kept])), covariance=True
    )
    same_bits(sol, clean, (*PER_ROW, "covariance"))
    assert np.array_equal(sol.nis[sol.accepted], clean.nis)
    trusting = navigator(FILTERS[name]).run(log)
    assert trusting.accepted.all()
    assert errors(trusting, truth).max() > 10 * errors(sol, truth)[20:].max()


@every_filter
@pytest.mark.parametrize("probability", [0.9, 0.99])
def test_gate_lets_good_fixes_through_as_often_as_asked(name: str, probability: float) -> None:
    truth = Truth(n=8000, seed=7)
    log = truth.log(
        each=4, vector_sun=(truth.t[1::4], *directions(truth, truth.t[1::4], [0.0, 0.0, 1.0], 1e-4))
    )
    nav = navigator(FILTERS[name], vector=cc.VectorSensor(1e-4), gate=probability)
    sol = nav.run(log, q0=truth.q[0], sigma0=(1e-3, 1e-4))
    for sensor in (0, 1):
        accepted = sol.accepted[sol.sensor == sensor]
        m = len(accepted)
        assert m == 2000
        tolerance = 5.0 * np.sqrt(m * probability * (1.0 - probability))
        assert abs((~accepted).sum() - m * (1.0 - probability)) < tolerance


def test_gate_is_the_quantile_of_chi_square() -> None:
    from scipy.stats import chi2

    truth = Truth(n=2000)
    log = truth.log(vector_sun=(truth.t[1::4], *directions(truth, truth.t[1::4], [0.0, 0.0, 1.0])))
    sol = navigator(vector=cc.VectorSensor(1e-3), gate=0.8).run(log)
    for dof in (2, 3):
        here = sol.dof == dof
        assert here.sum() > 400
        assert np.array_equal(sol.accepted[here], sol.nis[here] < chi2.ppf(0.8, dof))


def test_gate_of_one_is_no_gate() -> None:
    log = with_outliers(Truth(), [50], 1.0)
    same_bits(navigator(gate=1.0).run(log), navigator().run(log), PER_ROW + PER_FIX)
    assert navigator(gate=1.0).run(log).counts["rejected"] == 0


# starts


def test_start_is_the_first_fix() -> None:
    truth = Truth()
    log = truth.log(star=(truth.t[4::2], truth.fixes(truth.t[4::2])))
    star = log.stars["star"]
    sol = navigator().run(log, covariance=True)
    assert sol.t[0] == star.t[0]
    assert len(sol) == truth.n - 4
    assert quat.angle_between(sol.q[0], star.q[0]) < 1e-15
    assert sol.sigma[0] == pytest.approx([SIGMA] * 3 + [1e-3] * 3, rel=1e-12)
    assert sol.counts["start"] == 1
    assert np.array_equal(sol.measurement_t, star.t[1:])
    wide = navigator().run(log, sigma0=(1.0, [1e-4, 2e-4, 3e-4]))
    assert wide.sigma[0] == pytest.approx([SIGMA] * 3 + [1e-4, 2e-4, 3e-4], rel=1e-12)
    assert navigator().run(log, bias0=truth.bias[0]).bias[0] == pytest.approx(truth.bias[0])


@pytest.mark.parametrize("off", [0.002, 0.1, 1.0, 30.0])
def test_one_bad_first_fix_does_not_matter(off: float) -> None:
    """From a fifth of the noise's reach up, with a gate that would reject all the others."""
    truth = Truth()
    log = with_outliers(truth, [0], off * cc.DEG)
    sol = navigator(gate=0.9999).run(log)
    assert sol.counts["rejected"] <= 2
    assert errors(sol, truth)[-1] < 5 * SIGMA


def test_mass_rejection_warns() -> None:
    truth = Truth()
    log = truth.log(star=(truth.t, truth.fixes(truth.t)))
    wrong = {"q0": [0.0, 1.0, 0.0, 0.0], "sigma0": (1e-6, 1e-9)}
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate"):
        navigator(gate=0.9).run(log, **wrong)


def test_start_from_a_full_covariance() -> None:
    """A run in two parts is the run in one."""
    truth = Truth()
    log = truth.log(star=(truth.t[5::10], truth.fixes(truth.t[5::10])))
    whole = navigator().run(log)
    cut = 200
    first = navigator().run(
        cc.SensorLog(
            gyro=(log.gyro.t[: cut + 1], log.gyro.rate[: cut + 1]),
            star=(log.stars["star"].t, log.stars["star"].q),
        )
    )
    rest = cc.SensorLog(
        gyro=(log.gyro.t[cut:], log.gyro.rate[cut:]),
        star=(log.stars["star"].t, log.stars["star"].q),
    )
    end = first.final
    second = navigator().run(
        rest, t0=end["t"], q0=end["q"], bias0=end["bias"], covariance0=end["covariance"]
    )
    np.testing.assert_allclose(second.final["covariance"], whole.final["covariance"], rtol=1e-12)
    assert quat.angle_between(second.q[-1], whole.q[-1]) < 1e-13
    with pytest.raises(cc.InputError, match="covariance0"):
        navigator().run(log, q0=end["q"], covariance0=np.eye(5))
    with pytest.raises(cc.InputError, match="not both"):
        navigator().run(log, q0=end["q"], covariance0=np.eye(6), sigma0=(1.0, 1.0))
    with pytest.raises(cc.NumericalError, match="initial covariance"):
        navigator().run(log, q0=end["q"], covariance0=-np.eye(6))


def test_start_between_samples() -> None:
    truth = Truth()
    t = truth.t[3::2][:-1] + 0.05
    sol = navigator().run(truth.log(star=(t, truth.fixes(t))))
    assert np.array_equal(sol.t[:2], [t[0], truth.t[4]])  # the start, the sample after it
    assert errors(sol, truth)[0] < 5 * SIGMA + 1e-3 * 0.1
    every = navigator().run(truth.log(star=(t, truth.fixes(t))), period=1.0)
    assert every.t[0] == t[0]


@every_filter
@pytest.mark.parametrize("bad", [[0], [0, 1], [0, 2, 3], [1, 2], [6]])
def test_start_passes_over_outliers(name: str, bad: list[int]) -> None:
    truth = Truth()
    log = with_outliers(truth, bad, 0.1)
    star = log.stars["star"]
    good = next(k for k in range(7) if k not in bad)
    sol = navigator(FILTERS[name], gate=0.999999).run(log)
    assert sol.t[0] == star.t[good]
    assert quat.angle_between(sol.q[0], star.q[good]) < 1e-15
    assert sol.counts["outside"] == good  # rows before the start
    assert sol.counts["rejected"] == len([k for k in bad if k > good])
    assert errors(sol, truth).max() < 20 * SIGMA


def test_start_compares_fixes_along_a_fast_turn() -> None:
    t = np.arange(0.0, 50.0, 0.1)
    rate = np.tile([0.0, 0.0, 0.5], (len(t), 1))
    q = quat.propagate([1.0, 0, 0, 0], rate[:-1], 0.1)
    star = q[::20].copy()  # a radian apart
    star[0] = quat.multiply(star[0], quat.exp([0.5, 0.0, 0.0]))
    for gyro in (rate, rate + np.array([1e-3, -1e-3, 1e-3])):
        log = cc.SensorLog(gyro=(t, gyro), star=(t[::20], star))
        sol = navigator().run(log)
        assert sol.t[0] == t[20]


def test_given_start() -> None:
    truth = Truth()
    q0 = quat.multiply(truth.q[0], quat.exp([1e-3, 2e-3, -1e-3]))
    log = truth.log(star=(truth.t[4::2], truth.fixes(truth.t[4::2])))
    sigma0 = ([1e-3, 2e-3, 3e-3], [1e-5, 2e-5, 3e-5])
    sol = navigator().run(log, q0=q0, sigma0=sigma0, bias0=[1e-6, 0.0, 0.0], covariance=True)
    assert sol.t[0] == truth.t[0]
    assert quat.angle_between(sol.q[0], q0) < 1e-15
    assert np.array_equal(sol.bias[0], [1e-6, 0.0, 0.0])
    assert sol.sigma[0] == pytest.approx(np.r_[sigma0[0], sigma0[1]], rel=1e-14)
    assert sol.counts["start"] == 0
    assert sol.counts["accepted"] == len(log.stars["star"])
    r0 = Rotation.from_quat(q0, scalar_first=True)
    close(navigator().run(log, q0=r0, sigma0=sigma0, bias0=[1e-6, 0, 0]), sol, 1e-14)
    other = navigator().run(log, q0=-q0, sigma0=sigma0, bias0=[1e-6, 0, 0])
    assert np.array_equal(other.q, -sol.q)
    same_bits(other, sol, ("t", "rate", "bias", "sigma", *PER_FIX))


@pytest.mark.parametrize("offset", [0.0, 0.05, 0.12])
def test_given_time_of_start(offset: float) -> None:
    truth = Truth(noisy=False)
    t0 = truth.t[100] + offset
    log = truth.log(each=0)
    start = {"q0": truth.at(np.array([t0]))[0], "sigma0": (1e-9, 1e-9), "bias0": truth.bias[0]}
    sol = navigator().run(log, t0=t0, **start)
    assert np.array_equal(sol.t[:2], [t0, truth.t[101]])
    assert errors(sol, truth).max() < 1e-12


def test_one_sample_is_enough() -> None:
    log = cc.SensorLog(gyro=([5.0], [[0.1, 0.2, 0.3]]), star=([5.0], [[0.0, 1.0, 0.0, 0.0]]))
    for options in ({}, {"period": 1.0}, {"every": 3}, {"covariance": True}):
        sol = navigator().run(log, **options)
        assert np.array_equal(sol.t, [5.0])
        assert np.array_equal(np.abs(sol.q), [[0.0, 1.0, 0.0, 0.0]])
        assert np.array_equal(sol.rate, [[0.1, 0.2, 0.3]])
        assert len(sol.measurement_t) == 0


# behaviour: Ctrl-C, the GIL, progress


def long_log(n: int, fixes: int = 0) -> cc.SensorLog:
    t = np.arange(float(n))
    fix_t = np.linspace(0.0, n - 1.0, fixes) if fixes else np.zeros(1)
    q = np.tile([1.0, 0.0, 0.0, 0.0], (len(fix_t), 1))
    return cc.SensorLog(gyro=(t, np.zeros((n, 3))), star=(fix_t, q))


SLOW = navigator(cc.UKF(integrator="rk4"))
BUSY: dict[str, Callable[[], Callable[[], cc.Solution]]] = {}


def busy(function: Callable[[], Callable[[], cc.Solution]]) -> Any:
    BUSY[function.__name__] = function
    return function


@busy
def many_samples() -> Callable[[], cc.Solution]:
    log = long_log(1_000_000)
    return lambda: SLOW.run(log, every=1000)


@busy
def many_rows_between_few_samples() -> Callable[[], cc.Solution]:
    log = long_log(500)
    return lambda: SLOW.run(log, period=5e-4)


@busy
def many_fixes_between_few_samples() -> Callable[[], cc.Solution]:
    log = long_log(100, 500_000)
    return lambda: SLOW.run(log)


@contextmanager
def interrupted_after(delay: float) -> Iterator[list[float]]:
    """Send SIGINT to this process after a delay; yields when it was sent."""
    sent: list[float] = []
    done = threading.Event()

    def kill() -> None:
        if not done.wait(delay):
            sent.append(time.perf_counter())
            os.kill(os.getpid(), signal.SIGINT)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield sent
    finally:
        done.set()
        thread.join()


@pytest.mark.skipif(os.name == "nt", reason="os.kill ends the process there")
@pytest.mark.parametrize("kind", BUSY)
def test_ctrl_c_within_a_fifth_of_a_second(kind: str) -> None:
    run = BUSY[kind]()

    def for_ever() -> None:
        while True:
            run()

    waited = []
    for _ in range(3):  # a busy machine may let one attempt wait
        with interrupted_after(0.06) as sent, pytest.raises(KeyboardInterrupt):
            for_ever()
        waited.append(time.perf_counter() - sent[0])
        if waited[-1] < 0.2:
            break
    assert min(waited) < 0.2


def test_other_threads_run_on() -> None:
    log = long_log(600_000)
    ticks: list[float] = []
    done = threading.Event()

    def tick() -> None:
        while not done.wait(0.002):
            ticks.append(time.perf_counter())

    thread = threading.Thread(target=tick)
    thread.start()
    began = time.perf_counter()
    sol = SLOW.run(log, every=1000)
    ended = time.perf_counter()
    done.set()
    thread.join()
    assert sol.elapsed_s > 0.1
    stops = np.diff([began, *[t for t in ticks if began < t < ended], ended])
    assert stops.max() < 0.5 * sol.elapsed_s


def test_two_runs_at_once_give_the_same_bits() -> None:
    truth = Truth(n=20_000)
    log, nav = truth.log(), navigator(cc.UKF())
    alone = nav.run(log)
    found: list[cc.Solution] = []
    threads = [threading.Thread(target=lambda: found.append(nav.run(log))) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3
    for sol in found:
        same_bits(sol, alone, PER_ROW + PER_FIX)


def test_progress_is_told() -> None:
    n = 600_000
    told: list[tuple[int, int]] = []
    sol = SLOW.run(long_log(n), every=1000, progress=lambda done, total: told.append((done, total)))
    assert len(told) >= 2
    done = [d for d, _ in told]
    assert done == sorted(set(done))
    assert 0 < done[0] < done[-1] < n
    assert {total for _, total in told} == {n}
    same_bits(sol, SLOW.run(long_log(n), every=1000), PER_ROW)


@pytest.mark.parametrize("kind", [RuntimeError, KeyboardInterrupt, SystemExit, cc.CelestcoreError])
def test_an_error_in_progress_comes_out(kind: type[BaseException]) -> None:
    error = kind("stop here")

    def progress(done: int, total: int) -> None:
        raise error

    with pytest.raises(kind) as caught:
        SLOW.run(long_log(600_000), every=1000, progress=progress)
    assert caught.value is error


def test_a_run_inside_progress() -> None:
    small = Truth().log()
    inner: list[cc.Solution] = []
    SLOW.run(
        long_log(300_000),
        every=1000,
        progress=lambda *_: inner.append(navigator().run(small)),
    )
    assert inner
    same_bits(inner[0], navigator().run(small), PER_ROW)


def test_repr_names_everything() -> None:
    text = repr(navigator(cc.SRUKF(), gate=0.99))
    for part in ("SRUKF(", "Gyro(arw=1e-06", "StarCamera(", "gate=0.99"):
        assert part in text
