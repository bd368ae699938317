"""StarGyroNavigator.run: sensors, their mountings and their noise."""

from __future__ import annotations

from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from scipy.spatial.transform import Rotation
from truth import (
    ARW,
    CAMERA,
    FILTERS,
    PER_FIX,
    PER_ROW,
    RRW,
    SIGMA,
    Truth,
    close,
    directions,
    errors,
    every_filter,
    navigator,
    same_bits,
)

# sensors and their mountings


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
