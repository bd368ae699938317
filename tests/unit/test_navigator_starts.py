"""StarGyroNavigator.run: the gate, and where a run starts."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from scipy.spatial.transform import Rotation
from truth import (
    FILTERS,
    PER_FIX,
    PER_ROW,
    SIGMA,
    Truth,
    close,
    directions,
    errors,
    every_filter,
    navigator,
    same_bits,
    with_outliers,
)

# the gate


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
