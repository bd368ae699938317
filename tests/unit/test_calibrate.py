"""StarGyroNavigator.calibrate and gyro errors: what is reported, and where it is used."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
SIGMA = 2 * cc.ARCSEC
NAMES = ["scale_x", "scale_y", "scale_z"] + [
    f"misalignment_{a}" for a in ("xy", "xz", "yx", "yz", "zx", "zy")
]
TURN = ["alignment_x", "alignment_y", "alignment_z"]
MATRIX = np.array([[2e-3, -1e-3, 5e-4], [8e-4, -1e-3, -6e-4], [3e-4, 7e-4, 1.5e-3]])
ALIGNMENT = np.array([4e-4, -2e-4, 3e-4])
MOUNTINGS = {
    name: Rotation.from_rotvec(v)
    for name, v in (("star_1", [0.2, 0.1, -0.5]), ("star_2", [0.0, 1.2, 0.4]))
}


@lru_cache
def truth() -> tuple[Array, Array, Array]:
    """Return times, rates and attitudes: there and back about each axis in turn."""
    n = 1500
    k = np.arange(n)
    rate = np.zeros((n, 3))
    rate[k, k // 100 % 3] = 0.01 * np.sin(2.0 * np.pi * k / 100.0)
    return 0.5 * k, rate, quat.propagate(quat.exp([0.3, -0.5, 0.8]), rate[:-1], 0.5)


def fixes(rows: slice, noise: int, turn: Rotation) -> tuple[Array, Array]:
    """Fixes of a camera; `turn` leads from its frame to the body."""
    t, _, q = truth()
    rng = np.random.default_rng(noise)
    seen = quat.multiply(q[rows], quat.exp(SIGMA * rng.standard_normal((len(q[rows]), 3))))
    fixed = Rotation.from_quat(seen, scalar_first=True) * turn
    return t[rows], fixed.as_quat(scalar_first=True)


def make_log(cameras: int = 1, matrix: Array = MATRIX) -> cc.SensorLog:
    """One camera in the body frame, or two with mountings, the second one turned."""
    t, rate, _ = truth()
    rng = np.random.default_rng(0)
    measured = rate @ (np.eye(3) + matrix).T + 1e-5 + 1e-6 * rng.standard_normal(rate.shape)
    if cameras == 1:
        return cc.SensorLog(
            gyro=(t, measured), star=fixes(slice(0, None, 4), 1, Rotation.identity())
        )
    turned = Rotation.from_rotvec(ALIGNMENT) * MOUNTINGS["star_2"]
    return cc.SensorLog(
        gyro=(t, measured),
        star_1=fixes(slice(0, None, 4), 1, MOUNTINGS["star_1"]),
        star_2=fixes(slice(2, None, 4), 2, turned),
    )


def navigator(cameras: int = 1, filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    star: Any = cc.StarCamera(SIGMA)
    if cameras == 2:
        star = {name: cc.StarCamera(SIGMA, mounting=turn) for name, turn in MOUNTINGS.items()}
    return cc.StarGyroNavigator(filter, cc.Gyro(1e-6, 1e-9, **options), star)


@lru_cache
def found(cameras: int = 1) -> cc.Calibration:
    return navigator(cameras).calibrate(make_log(cameras))


@pytest.mark.parametrize("cameras", [1, 2])
def test_report(cameras: int) -> None:
    got = found(cameras)
    names = NAMES if cameras == 1 else NAMES + TURN
    assert list(got.value) == list(got.sigma) == list(got.prior_sigma) == names
    assert got.aligned == (None if cameras == 1 else "star_2")
    assert got.covariance.shape == (18, 18)
    assert np.array_equal(got.covariance, got.covariance.T)
    own = np.sqrt(np.diag(got.covariance))[6 : 6 + len(names)]
    assert own == pytest.approx(list(got.sigma.values()), rel=1e-15)
    assert set(got.prior_sigma.values()) == {0.01}
    for name in names:
        assert got.ratio[name] == got.sigma[name] / got.prior_sigma[name]
        assert got.observable[name] == (got.ratio[name] < 0.5)
    assert got.matrix[0, 1] == got.value["misalignment_xy"]
    assert got.matrix[2, 2] == got.value["scale_z"]
    text = str(got)
    assert all(name in text for name in names)
    assert len(text.splitlines()) == 1 + len(names)
    assert "not observable" not in text
    assert got.solution.filter == "ekf"
    assert len(got.solution) == len(truth()[0])
    assert np.array_equal(got.solution.final["covariance"], got.covariance[:6, :6])


def test_values_are_the_true_ones() -> None:
    got = found(2)
    sigma = np.array(list(got.sigma.values()))
    true = [MATRIX[i, i] for i in range(3)]
    true += [MATRIX[i, j] for i, j in ((0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))]
    off = (np.array(list(got.value.values())) - np.array([*true, *ALIGNMENT])) / sigma
    assert np.abs(off).max() < 3.5
    assert sigma.max() < 1e-4


def test_which_camera_is_aligned() -> None:
    log, nav = make_log(2), navigator(2)
    second, first = found(2), nav.calibrate(log, aligned="star_1")
    assert first.aligned == "star_1"
    # the other way round it is the other way round: seen from the second camera's body
    a, b = (np.array([got.value[n] for n in TURN]) for got in (second, first))
    assert np.abs(a + b).max() < 3e-6
    for got, name in ((second, "star_2"), (first, "star_1")):
        for camera in MOUNTINGS:
            own = got.navigator.star[camera]
            moved = Rotation.from_quat(own.mounting, scalar_first=True) * MOUNTINGS[camera].inv()
            if camera == name:
                turn = [got.value[n] for n in TURN]
                assert np.abs(moved.as_rotvec() - turn).max() < 1e-12
            else:
                assert moved.magnitude() < 1e-15
    three = cc.SensorLog(
        gyro=log.gyro,
        **{name: log.stars[name] for name in MOUNTINGS},
        star_3=fixes(slice(1, None, 4), 3, Rotation.identity()),
    )
    cameras = {**nav.star, "star_3": cc.StarCamera(SIGMA)}
    got = cc.StarGyroNavigator(None, nav.gyro, cameras).calibrate(three, aligned="star_2")
    assert np.abs(np.array([got.value[n] for n in TURN]) - ALIGNMENT).max() < 3e-6
    assert set(got.navigator.star) == {"star_1", "star_2", "star_3"}


def test_priors_are_what_is_known_beforehand() -> None:
    log, nav = make_log(2), navigator(2)
    given = {"scale_sigma": 1e-8, "misalignment_sigma": 2e-8, "alignment_sigma": 3e-8}
    got = nav.calibrate(log, **given)
    assert [got.prior_sigma[n] for n in ("scale_x", "misalignment_zy", "alignment_x")] == [
        1e-8,
        2e-8,
        3e-8,
    ]
    for name in got.value:  # so sure that nothing is learnt
        assert got.ratio[name] > 0.8
        assert abs(got.value[name]) < 1e-6
        assert not got.observable[name]
    assert str(got).count("not observable in this log") == 12


def test_options_of_run_are_passed_on() -> None:
    log, (t, _, q) = make_log(), truth()
    told: list[int] = []
    got = navigator().calibrate(
        log,
        t0=t[200],
        q0=q[200],
        sigma0=(1e-3, 1e-4),
        every=10,
        covariance=True,
        progress=lambda done, total: told.append(done),
    )
    assert got.solution.t[0] == t[200]
    assert len(got.solution) == 130
    assert got.solution.covariance is not None
    assert got.solution.counts["start"] == 0


def test_calibration_without_errors_is_the_ekf() -> None:
    """With parameters that are known the 18-state filter is the plain one."""
    log = make_log(2, np.zeros((3, 3)))
    nav = navigator(2)
    known = {"scale_sigma": 1e-12, "misalignment_sigma": 1e-12, "alignment_sigma": 1e-12}
    got, sol = nav.calibrate(log, **known).solution, nav.run(log)
    assert np.array_equal(got.t, sol.t)
    assert quat.angle_between(got.q, sol.q).max() < 1e-12
    np.testing.assert_allclose(got.sigma, sol.sigma, rtol=1e-6)
    np.testing.assert_allclose(got.nis, sol.nis, rtol=1e-5)


def test_same_bits_every_time() -> None:
    a, b = (navigator(2).calibrate(make_log(2)) for _ in range(2))
    assert np.array_equal(a.covariance, b.covariance)
    assert a.value == b.value


def test_corrected_navigator_keeps_everything_else() -> None:
    log = make_log()
    nav = cc.StarGyroNavigator(
        cc.UKF(),
        cc.Gyro(1e-6, 1e-9, max_gap=3.0, mounting=Rotation.identity()),
        cc.StarCamera(SIGMA),
        cc.VectorSensor(1e-3),
        gate=0.999,
    )
    new = nav.calibrate(log).navigator
    assert new.filter == nav.filter
    assert (new.gate, new.vector, new.star) == (nav.gate, nav.vector, nav.star)
    assert (new.gyro.arw, new.gyro.rrw, new.gyro.max_gap) == (1e-6, 1e-9, 3.0)
    assert nav.gyro.errors is None  # the old one is as it was
    assert np.abs(np.asarray(new.gyro.errors) - MATRIX).max() < 5e-5


def test_corrected_navigator_smooths_and_streams_to_the_same_bits() -> None:
    """The gyro's errors are taken out in the same place by all three."""
    log, (t, _, q) = make_log(), truth()
    nav = found().navigator
    start = {"sigma0": (1e-3, 1e-4)}
    sol = nav.run(log, q0=q[0], covariance=True, **start)
    state = nav.start(t[0], q[0], **start)
    assert log.gyro is not None
    star = dict(zip(log.stars["star"].t, log.stars["star"].q, strict=True))
    for row, (at, rate) in enumerate(zip(t, log.gyro.rate, strict=True)):
        state.predict(at, rate)
        if at in star:
            state.update(at, star[at])
        assert np.array_equal(state.bias, sol.bias[row])
        assert np.array_equal(np.abs(state.q), np.abs(sol.q[row]))
        assert sol.covariance is not None
        assert np.array_equal(state.covariance, sol.covariance[row])
    assert np.array_equal(nav.smooth(log, q0=q[0], **start).bias[-1], sol.bias[-1])


def test_errors_of_the_gyro_are_taken_out() -> None:
    """And a mounting before them: errors are in body axes."""
    log = make_log()
    assert log.gyro is not None
    turn = Rotation.from_rotvec([0.5, 1.0, -0.3])
    clean = (log.gyro.rate) @ np.linalg.inv(np.eye(3) + MATRIX).T
    plain = navigator().run(cc.SensorLog(gyro=(log.gyro.t, clean), star=log.stars["star"]))
    for own, rate in (
        (navigator(errors=MATRIX), log.gyro.rate),
        (navigator(errors=MATRIX, mounting=turn), turn.inv().apply(np.array(log.gyro.rate))),
    ):
        sol = own.run(cc.SensorLog(gyro=(log.gyro.t, rate), star=log.stars["star"]))
        assert quat.angle_between(sol.q, plain.q).max() < 1e-12
        assert np.abs(sol.rate - plain.rate).max() < 1e-14
    gyro = cc.Gyro(1e-6, errors=MATRIX)
    np.testing.assert_allclose(
        gyro.to_body(log.gyro.rate) @ (np.eye(3) + MATRIX).T, log.gyro.rate, rtol=0.0, atol=1e-17
    )
    assert hash(gyro) == hash(cc.Gyro(1e-6, errors=MATRIX.tolist()))
    assert gyro == cc.Gyro(1e-6, errors=MATRIX.tolist())


def half(log: cc.SensorLog, second: bool) -> cc.SensorLog:
    assert log.gyro is not None
    gyro, star = log.gyro, log.stars["star"]
    middle = 0.5 * (gyro.t[0] + gyro.t[-1])
    a, b = ((table.t > middle) == second for table in (gyro, star))
    return cc.SensorLog(gyro=(gyro.t[a], gyro.rate[a]), star=(star.t[b], star.q[b]))


def test_real_log() -> None:
    """Twelve hours of Fermi: two halves agree, and each makes the other's predictions better."""
    log = cc.sample("fermi")
    nav = cc.Settings.from_log(log).navigator()
    got = [nav.calibrate(half(log, second)) for second in (False, True)]
    for name in NAMES:
        (a, b), (sa, sb) = [[g.value[name] for g in got], [g.sigma[name] for g in got]]
        assert abs(a - b) < 3.5 * np.hypot(sa, sb), name
        assert max(g.ratio[name] for g in got) < 0.1, name
    for trained, other in ((got[0], half(log, True)), (got[1], half(log, False))):
        drift = [
            cc.analysis.withheld_drift(n, other, 600.0, folds=None).summary()
            for n in (nav, trained.navigator)
        ]
        median = [d["drift_median_arcsec"] for d in drift]
        print(f"600 s without fixes: {median[0]:.0f} arcsec, calibrated {median[1]:.0f}")
        assert median[1] < 0.6 * median[0]
