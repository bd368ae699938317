"""StarGyroState, fed sample by sample: the bits of a run, copies, errors that leave it alone."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from celestcore.navigator import StarGyroState
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation
from streams import everything

Array = NDArray[np.float64]
SIGMA = 10 * cc.ARCSEC
GYRO, CAMERA = cc.Gyro(1e-6, 1e-8), cc.StarCamera(SIGMA)
FILTERS = {
    "ekf": cc.EKF(),
    "ukf": cc.UKF(),
    "srukf": cc.SRUKF(),
    "ekf-rk4": cc.EKF("rk4"),
    "ukf-scaled": cc.UKF(alpha=0.5, beta=1.0, kappa=0.0, integrator="rk4"),
}
every_filter = pytest.mark.parametrize("name", FILTERS)
IDENTITY = [1.0, 0.0, 0.0, 0.0]
SUN = np.array([0.0, 0.6, 0.8])
START = ([0.001, 0.002, 0.003], [1e-4, 2e-4, 3e-4])


def navigator(filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, **{"gyro": GYRO, "star": CAMERA, **options})


def make_log(n: int = 300, seed: int = 0) -> cc.SensorLog:
    """Irregular gyro samples; star fixes at every other sample and between, with own noise."""
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.05, 0.3, n))
    rate = 0.1 * np.sin(0.3 * t[:, None] + [0.0, 1.0, 2.0])
    q = quat.propagate(quat.exp([0.3, -0.5, 0.8]), rate[:-1], np.diff(t))
    rate = rate + 1e-5 + 1e-6 * rng.normal(size=(n, 3))
    k = np.arange(10, n - 1, 3)
    between = t[k] + rng.uniform(0.1, 0.9, len(k)) * (t[k + 1] - t[k])
    fix_t = np.sort(np.r_[t[1::2], between])
    part = np.searchsorted(t, fix_t, side="right") - 1
    s = (fix_t - t[part]) / np.r_[np.diff(t), 1.0][part]
    fix_q = quat.slerp(q[part], q[np.minimum(part + 1, n - 1)], s)
    fix_q = quat.multiply(fix_q, quat.exp(SIGMA * rng.normal(size=(len(fix_t), 3))))
    fix_q *= np.where(rng.random(len(fix_t)) < 0.5, -1.0, 1.0)[:, None]
    noise = SIGMA * rng.uniform(0.5, 3.0, (len(fix_t), 3))
    fix_q[20] = quat.multiply(fix_q[20], quat.exp([0.1, 0.0, 0.0]))  # for the gate
    body = quat.rotate(quat.conjugate(q[::5]), SUN)
    inertial = np.tile(SUN, (len(body), 1))
    return cc.SensorLog(
        gyro=(t, rate), star=(fix_t, fix_q, noise), vector_sun=(t[::5], body, inertial)
    )


def events(log: cc.SensorLog) -> list[tuple[float, int, int]]:
    """Everything in the order of a run: time, then kind (gyro, star, vector), then row."""
    assert log.gyro is not None
    tables = (log.gyro.t, log.stars["star"].t, log.vectors["sun"].t)
    rows = [(t, kind, k) for kind, ts in enumerate(tables) for k, t in enumerate(ts.tolist())]
    return sorted(rows)


def feed(state: StarGyroState, log: cc.SensorLog, event: tuple[float, int, int]) -> Any:
    t, kind, k = event
    assert log.gyro is not None
    if kind == 0:
        return state.predict(t, log.gyro.rate[k])
    if kind == 1:
        star = log.stars["star"]
        assert star.sigma is not None
        return state.update(t, star.q[k], sigma=star.sigma[k])
    sun = log.vectors["sun"]
    return state.update_direction(t, sun.body[k], sun.inertial[k], sensor="sun")


def begin(nav: cc.StarGyroNavigator, log: cc.SensorLog) -> StarGyroState:
    return nav.start(log.span[0], quat.exp([0.3, -0.5, 0.8]), sigma0=START)


# the same as a run


@every_filter
def test_stream_equals_run_to_the_last_bit(name: str) -> None:
    log = make_log()
    nav = navigator(FILTERS[name], gate=0.999999, vector={"sun": cc.VectorSensor(1e-3)})
    sol = nav.run(log, q0=quat.exp([0.3, -0.5, 0.8]), sigma0=START, covariance=True)
    state = begin(nav, log)
    updates, row = [], 0
    order = events(log)
    for event, following in zip(order, [*order[1:], None], strict=True):
        used = feed(state, log, event)
        if event[1] > 0:
            updates.append(used)
        if following is not None and following[0] == event[0]:
            continue  # more comes at this time
        if event[0] != sol.t[row]:
            continue  # between two samples
        assert sol.covariance is not None
        assert state.t == sol.t[row]
        sign = np.sign(state.q @ sol.q[row])
        assert np.array_equal(sign * state.q, sol.q[row])
        assert np.array_equal(state.bias, sol.bias[row])
        assert np.array_equal(state.covariance, sol.covariance[row])
        assert np.array_equal(state.sigma, np.sqrt(np.diag(sol.covariance[row])))
        assert state.sigma == pytest.approx(sol.sigma[row], rel=1e-14)
        assert np.array_equal(state.rate, sol.rate[row])
        row += 1
    assert row == len(sol)
    assert [u.nis for u in updates] == sol.nis.tolist()
    assert [u.accepted for u in updates] == sol.accepted.tolist()
    assert [u.dof for u in updates] == sol.dof.tolist()
    assert 0 < np.count_nonzero(~sol.accepted) < 5
    for u, innovation, sigma in zip(updates, sol.innovation, sol.innovation_sigma, strict=True):
        assert np.array_equal(u.innovation, innovation[: u.dof])
        assert np.array_equal(np.sqrt(np.diag(u.covariance)), sigma[: u.dof])


@every_filter
@pytest.mark.parametrize("sampling", ["integrated", "average"])
def test_other_samplings_equal_run_with_fixes_at_samples(name: str, sampling: str) -> None:
    log = make_log()
    assert log.gyro is not None
    t, q = log.gyro.t[1::2], log.stars["star"].q[: len(log.gyro.t[1::2])]
    sun = log.vectors["sun"]
    log = cc.SensorLog(gyro=log.gyro, star=(t, q, np.full(len(t), SIGMA)), vector_sun=sun)
    gyro = cc.Gyro(1e-6, 1e-8, sampling=sampling)
    nav = navigator(FILTERS[name], gyro=gyro, vector=cc.VectorSensor(1e-3))
    sol = nav.run(log, q0=quat.exp([0.3, -0.5, 0.8]), sigma0=START)
    state = begin(nav, log)
    for event in events(log):
        feed(state, log, event)
    assert np.array_equal(np.abs(state.q), np.abs(sol.final["q"]))
    assert np.array_equal(state.bias, sol.final["bias"])
    assert np.array_equal(state.covariance, sol.final["covariance"])


def test_gap_equals_run_if_its_limit_is_given() -> None:
    t = np.r_[np.arange(10.0), 60.0 + np.arange(10.0)]
    log = cc.SensorLog(gyro=(t, np.full((20, 3), 1e-3)))
    start = {"sigma0": (1e-3, 1e-5)}
    for limit, same in ((5.0, True), (None, False)):
        nav = navigator(gyro=cc.Gyro(1e-6, 1e-8, max_gap=limit, gap_rate_sigma=1e-3))
        sol = nav.run(log, q0=IDENTITY, **start)
        assert sol.counts["gaps"] == 1
        state = nav.start(0.0, IDENTITY, **start)
        for k in range(20):
            state.predict(t[k], [1e-3] * 3)
        assert np.array_equal(state.covariance, sol.final["covariance"]) is same


def test_mountings_are_those_of_run() -> None:
    log = make_log()
    assert log.gyro is not None
    q_bg = Rotation.from_euler("xyz", [20, -70, 110], degrees=True)
    q_bc = Rotation.from_euler("xyz", [-40, 10, 70], degrees=True)
    star, sun = log.stars["star"], log.vectors["sun"]
    rate, q, body = (np.array(x) for x in (log.gyro.rate, star.q, sun.body))
    turned = cc.SensorLog(
        gyro=(log.gyro.t, q_bg.inv().apply(rate)),
        star=(star.t, Rotation.from_quat(q, scalar_first=True) * q_bc, star.sigma),
        vector_sun=(sun.t, q_bc.inv().apply(body), sun.inertial),
    )
    nav = navigator(
        gyro=cc.Gyro(1e-6, 1e-8, mounting=q_bg),
        star={"star": cc.StarCamera(mounting=q_bc)},
        vector={"sun": cc.VectorSensor(1e-3, mounting=q_bc)},
    )
    sol = nav.run(turned, q0=quat.exp([0.3, -0.5, 0.8]), sigma0=START)
    state = begin(nav, turned)
    for event in events(turned):
        feed(state, turned, event)
    assert quat.angle_between(state.q, sol.final["q"]) < 1e-13
    assert np.abs(state.bias - sol.final["bias"]).max() < 1e-13
    assert state.sigma == pytest.approx(sol.final["sigma"], rel=1e-10)


def test_noise_of_a_fix() -> None:
    nav = navigator(star={"a": CAMERA, "b": cc.StarCamera(3 * SIGMA)})
    fresh = nav.start(0.0, IDENTITY, sigma0=START)
    q = quat.exp([1e-4, 2e-4, -1e-4])

    def after(**options: Any) -> tuple[Any, ...]:
        state = fresh.copy()
        state.update(0.0, q, **options)
        return everything(state)

    assert after(camera="a") == after(camera="b", sigma=SIGMA)
    assert after(camera="a") == after(camera="b", sigma=[SIGMA] * 3)
    assert after(camera="a") != after(camera="b")
    own = np.array([[2.0, 0.3, 0.0], [0.3, 1.0, 0.1], [0.0, 0.1, 3.0]]) * SIGMA**2
    assert after(camera="a", covariance=own) == after(camera="b", covariance=own)
    assert after(camera="a", covariance=own) != after(camera="a")
    used = fresh.copy().update(0.0, q, camera="a", covariance=own)
    assert used.covariance == pytest.approx(np.diag(np.square(START[0])) + own, rel=1e-12)
    assert used.innovation == pytest.approx([1e-4, 2e-4, -1e-4], abs=1e-15)


def test_one_update_in_numbers() -> None:
    state = navigator().start(5.0, IDENTITY, bias=[1e-5, 0.0, 0.0], sigma0=(SIGMA, 1e-6))
    assert (state.t, state.rate) == (5.0, None)
    assert np.array_equal(state.bias, [1e-5, 0.0, 0.0])
    used = state.update(5.0, quat.exp([SIGMA, 0.0, 0.0]))
    assert used.accepted
    assert used.dof == 3
    assert used.nis == pytest.approx(0.5, rel=1e-9)
    assert state.sigma[:3] == pytest.approx([SIGMA / 2**0.5] * 3, rel=1e-6)
    assert quat.log(state.q) == pytest.approx([SIGMA / 2, 0.0, 0.0], abs=1e-15)
    assert repr(used) == "Update(accepted=True, nis=0.500000, dof=3)"
    assert repr(state).startswith("StarGyroState(t=5, q=[")
    state.predict(5.0, [0.1, 0.2, 0.3])
    assert state.rate == pytest.approx([0.1 - 1e-5, 0.2, 0.3])


def test_gate_rejects_and_leaves_the_belief() -> None:
    state = navigator(gate=0.9999, vector=cc.VectorSensor(1e-3)).start(0.0, IDENTITY, sigma0=START)
    before = everything(state)
    used = state.update(0.0, quat.exp([0.5, 0.0, 0.0]))
    assert not used.accepted
    assert used.nis > 1e3
    assert everything(state) == before
    used = state.update_direction(0.0, [0.0, 0.0, 1.0], [0.0, 1.0, 0.0])
    assert (used.accepted, used.dof) == (False, 2)
    assert everything(state) == before


def test_opposite_direction_is_no_good_fit() -> None:
    nav = navigator(gate=0.9999, vector=cc.VectorSensor(1e-3))
    for turn in ([0.0, 0.0, 0.0], [0.0, 1e-9, 0.0], [0.0, 1e-3, 0.0]):
        state = nav.start(0.0, IDENTITY, sigma0=START)
        body = quat.rotate(quat.exp(turn), [-1.0, 0.0, 0.0])
        used = state.update_direction(0.0, body, [1.0, 0.0, 0.0])
        assert not used.accepted
        assert np.linalg.norm(used.innovation) == pytest.approx(np.pi, abs=2e-3)


@pytest.mark.parametrize("value", [-1.0, 1.0])
def test_sign_of_a_fix_does_not_matter(value: float) -> None:
    state = navigator().start(0.0, IDENTITY)
    used = state.update(0.0, value * quat.exp([1e-4, 0.0, 0.0]))
    assert used.innovation == pytest.approx([1e-4, 0.0, 0.0], abs=1e-15)


def test_kinds_of_rates() -> None:
    values = [0.125, -0.25, 0.5]
    wide = np.zeros(6)
    wide[::2] = values
    kinds: list[Any] = [
        values,
        tuple(values),
        np.array(values),
        np.array(values, dtype=np.float32),
        np.array(values, dtype=">f8"),
        wide[::2],
        np.array([values, values])[1],
        [np.float32(v) for v in values],
    ]
    found = set()
    for kind in kinds:
        state = navigator().start(0.0, IDENTITY)
        state.predict(0.0, kind)
        state.predict(1.0, kind)
        found.add(everything(state))
    assert len(found) == 1


def test_start_takes_rotations_and_rounded_quaternions() -> None:
    r = Rotation.from_rotvec([0.1, 0.2, 0.3])
    q = r.as_quat(scalar_first=True)
    a = navigator().start(0.0, r, sigma0=START)
    b = navigator().start(0.0, q * 1.0004, sigma0=START)
    assert np.abs(a.q - b.q).max() < 1e-15
    assert abs(np.linalg.norm(b.q) - 1.0) < 1e-15
    assert np.array_equal(a.covariance, np.diag(np.square(np.ravel(START))))
    b.update(0.0, r)
    assert quat.angle_between(b.q, q) < 1e-15


# copies


COPIES: dict[str, Callable[[StarGyroState], StarGyroState]] = {
    "copy()": lambda s: s.copy(),
    "copy.copy": copy.copy,
    "copy.deepcopy": copy.deepcopy,
    **{
        f"pickle {p}": (lambda s, p=p: pickle.loads(pickle.dumps(s, protocol=p)))
        for p in range(2, pickle.HIGHEST_PROTOCOL + 1)
    },
}


@every_filter
@pytest.mark.parametrize("how", COPIES)
def test_copies_go_on_to_the_same_bits(name: str, how: str) -> None:
    log = make_log(60)
    nav = navigator(FILTERS[name], gate=0.999999, vector=cc.VectorSensor(1e-3))
    order = events(log)
    state = begin(nav, log)
    copies = []
    for k, event in enumerate(order):
        if k in (0, 1, 20, 51, 52, 53):
            copies.append((k, COPIES[how](state), everything(state)))
        feed(state, log, event)
    for k, other, then in copies:
        assert everything(other) == then  # untouched by what the first one did since
        for event in order[k:]:
            feed(other, log, event)
        assert everything(other) == everything(state)
        assert np.array_equal(other.covariance, state.covariance)


class Tracked(StarGyroState):
    """A state with things of its own."""

    notes: list[str]

    def predict(self, t: float, rate: Any) -> None:
        super().predict(t, rate)
        self.notes.append(f"predict {t}")


@pytest.mark.parametrize("how", COPIES)
def test_subclasses_stay_what_they_are(how: str) -> None:
    state = Tracked(navigator(), 0.0, IDENTITY, (0.0, 0.0, 0.0), START)
    state.notes = []
    state.predict(0.0, [0.0, 0.0, 0.1])
    other = COPIES[how](state)
    assert type(other) is Tracked
    assert other.notes == ["predict 0.0"]
    other.predict(1.0, [0.0, 0.0, 0.1])
    assert other.notes[-1] == "predict 1.0"
    assert other.t == 1.0
    assert state.t == 0.0


# errors leave the state as it was


def running() -> StarGyroState:
    nav = navigator(
        star={"star": CAMERA, "blind": cc.StarCamera()}, vector={"sun": cc.VectorSensor(1e-3)}
    )
    state = nav.start(0.0, IDENTITY, sigma0=START)
    state.predict(0.0, [0.0, 0.0, 0.01])
    state.predict(1.0, [0.0, 0.01, 0.01])
    return state


Q = quat.exp([0.0, 0.0, 0.01])
UP = [0.0, 0.0, 1.0]
BAD: dict[str, tuple[Callable[[StarGyroState], Any], str]] = {
    "predict back": (lambda s: s.predict(0.5, UP), r"predict.* 0\.5.*before.* 1.0 s"),
    "update back": (lambda s: s.update(0.5, Q), r"update.* 0\.5.*before.* 1.0 s"),
    "direction back": (lambda s: s.update_direction(0.5, UP, UP, sensor="sun"), "before.* 1.0 s"),
    "nan rate": (lambda s: s.predict(2.0, [0.0, np.nan, 0.0]), r"(?i)rate.*nan.*finite"),
    "inf rate": (lambda s: s.predict(2.0, np.array([np.inf, 0.0, 0.0])), r"rate.*finite"),
    "nan time": (lambda s: s.predict(np.nan, UP), r"(?i)nan.*finite"),
    "inf time": (lambda s: s.predict(np.inf, UP), r"inf.*finite"),
    "two rates": (lambda s: s.predict(2.0, [0.0, 0.0]), "rate must be three numbers"),
    "four rates": (lambda s: s.predict(2.0, np.zeros(4)), "rate must be three numbers"),
    "rows of rates": (lambda s: s.predict(2.0, np.zeros((1, 3))), "rate must be three numbers"),
    "text": (lambda s: s.predict(2.0, "abc"), "rate must be three numbers"),
    "nothing": (lambda s: s.predict(2.0, None), "rate must be three numbers"),
    "complex": (lambda s: s.predict(2.0, [1j, 0.0, 0.0]), "rate must be three numbers"),
    "nan time of fix": (lambda s: s.update(np.nan, Q), r"t, value nan: must be finite"),
    "inf time of fix": (lambda s: s.update(np.inf, Q), r"t, value inf: must be finite"),
    "nan fix": (lambda s: s.update(2.0, [np.nan, 0, 0, 0]), r"q, value .*nan.* must be finite"),
    "zero fix": (lambda s: s.update(2.0, [0.0] * 4), r"q, value .*is zero"),
    "long fix": (lambda s: s.update(2.0, 1.1 * Q), r"q, value .*has norm 1.1 where a unit"),
    "three numbers": (lambda s: s.update(2.0, Q[:3]), r"q: has shape \(3,\)"),
    "two fixes": (lambda s: s.update(2.0, [Q, Q]), r"q: needs one quaternion"),
    "zero sigma": (lambda s: s.update(2.0, Q, sigma=0.0), r"sigma.*must be positive"),
    "negative sigma": (lambda s: s.update(2.0, Q, sigma=-SIGMA), r"sigma.*must be positive"),
    "nan sigma": (lambda s: s.update(2.0, Q, sigma=np.nan), r"sigma.*finite"),
    "two sigmas": (lambda s: s.update(2.0, Q, sigma=[1.0, 1.0]), r"sigma.*one finite .* or three"),
    "flat covariance": (
        lambda s: s.update(2.0, Q, covariance=np.zeros((3, 3))),
        "covariance.*positive definite",
    ),
    "skew covariance": (
        lambda s: s.update(2.0, Q, covariance=np.eye(3) + np.eye(3, k=1)),
        "covariance.*symmetric",
    ),
    "nan covariance": (
        lambda s: s.update(2.0, Q, covariance=np.full((3, 3), np.nan)),
        "covariance.*finite",
    ),
    "small covariance": (
        lambda s: s.update(2.0, Q, covariance=np.eye(2)),
        r"covariance: has shape \(2, 2\)",
    ),
    "unknown camera": (lambda s: s.update(2.0, Q, camera="star_9"), r"star_9: .*star, blind"),
    "no noise": (lambda s: s.update(2.0, Q, camera="blind"), "no noise"),
    "unknown sensor": (lambda s: s.update_direction(2.0, UP, UP, sensor="mag"), "mag: .*sun"),
    "no direction": (lambda s: s.update_direction(2.0, [0.0] * 3, UP, sensor="sun"), "direction"),
    "nan direction": (
        lambda s: s.update_direction(2.0, UP, [np.nan] * 3, sensor="sun"),
        "direction",
    ),
    "two components": (lambda s: s.update_direction(2.0, UP[:2], UP, sensor="sun"), "body"),
    "bad sigma": (
        lambda s: s.update_direction(2.0, UP, UP, sensor="sun", sigma=-1.0),
        "sigma.*greater than 0",
    ),
}


@pytest.mark.parametrize("case", BAD)
def test_errors_leave_the_state_as_it_was(case: str) -> None:
    call, message = BAD[case]
    state = running()
    before = everything(state)
    with pytest.raises(cc.CelestcoreError, match=message):
        call(state)
    assert everything(state) == before


@every_filter
def test_failed_update_goes_back_in_time_too(name: str) -> None:
    """A fix after the state's time moves the state first; if it fails, that is undone."""
    state = navigator(FILTERS[name]).start(0.0, IDENTITY, sigma0=START)
    state.predict(0.0, [0.0, 0.0, 0.01])
    before = everything(state)
    with pytest.raises(cc.NumericalError, match=r"t = 0\.5"):
        state.update_star(0.5, Q.tolist(), [-1.0, 0.0, 0.0, -1.0, 0.0, -1.0])
    assert everything(state) == before
    state.update(0.5, Q)
    assert state.t == 0.5


@every_filter
def test_failed_predict_leaves_the_state_as_it_was(name: str) -> None:
    state = navigator(FILTERS[name]).start(0.0, IDENTITY, sigma0=START)
    state.predict(0.0, [1e300] * 3)
    before = everything(state)
    for _ in range(2):
        with pytest.raises(cc.NumericalError, match=r"step 0.* 1 s"):
            state.predict(1.0, [0.0, 0.0, 0.01])
        assert everything(state) == before


def test_update_before_the_first_predict() -> None:
    state = navigator().start(1.0, IDENTITY, sigma0=START)
    before = everything(state)
    with pytest.raises(cc.InputError, match="no gyro sample has told the rate yet"):
        state.update(2.0, IDENTITY)
    assert everything(state) == before
    assert state.update(1.0, IDENTITY).accepted  # at the state's own time nothing must be known
    state.predict(2.0, [0.0, 0.0, 0.1])  # the first sample stands for the time before it
    assert quat.log(state.q) == pytest.approx([0.0, 0.0, 0.1], abs=1e-12)
    assert state.update(2.5, quat.exp([0.0, 0.0, 0.15])).accepted
    assert state.t == 2.5


STARTS: dict[str, tuple[dict[str, Any], str]] = {
    "nan time": ({"t": np.nan}, "t, value nan: must be finite"),
    "zero": ({"q": [0.0] * 4}, "q, value .*is zero"),
    "long": ({"q": [2.0, 0, 0, 0]}, "q, value .*has norm 2"),
    "nan": ({"q": [np.nan, 0, 0, 0]}, "q, value .*finite"),
    "short": ({"q": [1.0, 0.0, 0.0]}, "q: has shape"),
    "nothing": ({"q": None}, "q: has shape"),
    "bias": ({"bias": [0.0, 0.0]}, "bias.*three"),
    "nan bias": ({"bias": [0.0, 0.0, np.nan]}, "bias.*finite"),
    "one sigma0": ({"sigma0": 1e-3}, r"sigma0.*\(attitude \[rad\], bias \[rad/s\]\)"),
    "three sigma0": ({"sigma0": (1.0, 1.0, 1.0)}, "sigma0.*attitude"),
    "zero sigma0": ({"sigma0": (0.0, 1e-3)}, "sigma0.*positive"),
    "negative sigma0": ({"sigma0": (1e-3, [1e-3, -1e-3, 1e-3])}, "sigma0.*positive"),
    "nan sigma0": ({"sigma0": (np.nan, 1e-3)}, "sigma0.*finite"),
}


@pytest.mark.parametrize("case", STARTS)
def test_bad_starts(case: str) -> None:
    options, message = STARTS[case]
    with pytest.raises(cc.InputError, match=message):
        navigator().start(**{"t": 0.0, "q": IDENTITY, "sigma0": START, **options})


@pytest.mark.parametrize("matrix", [np.eye(5), np.zeros((6, 7)), np.zeros(36)])
def test_restore_refuses_what_is_no_snapshot(matrix: Array) -> None:
    state = running()
    before = everything(state)
    parts = state._snapshot()
    with pytest.raises(cc.InputError, match="matrix"):
        state._restore((*parts[:3], matrix, *parts[4:]))
    with pytest.raises((TypeError, ValueError)):
        state._restore(parts[:3])
    assert everything(state) == before
