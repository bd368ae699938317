"""Bad input to the navigator and to quaternion functions: clear errors of one family, no panic."""

from __future__ import annotations

import os
import subprocess
import sys
import textwrap
import warnings
from collections.abc import Callable
from typing import Any, cast

import celestcore as cc
import numpy as np
import pytest
from celestcore import quaternion as quat
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

T = np.arange(50.0)
RATE = np.tile([0.0, 0.0, 0.01], (50, 1))
Q = quat.propagate([1.0, 0.0, 0.0, 0.0], RATE[:-1], 1.0)
IDENTITY = [1.0, 0.0, 0.0, 0.0]
START: dict[str, Any] = {"q0": IDENTITY, "sigma0": (1e-3, 1e-4)}
GYRO, CAMERA = cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5)
LOG = cc.SensorLog(gyro=(T, RATE), star=(T[::2], Q[::2]))
FILTERS = {"ekf": cc.EKF(), "ukf": cc.UKF(), "srukf": cc.SRUKF()}


def navigator(filter: Any = None, **options: Any) -> cc.StarGyroNavigator:  # noqa: A002
    return cc.StarGyroNavigator(filter, **{"gyro": GYRO, "star": CAMERA, **options})


def run(log: Any = LOG, filter: Any = None, nav: Any = (), **options: Any) -> cc.Solution:  # noqa: A002
    return navigator(filter, **dict(nav)).run(log, **options)


def put(a: Any, row: int, value: Any) -> Any:
    out = np.array(a)
    out[row] = value
    return out


# one table of everything: what goes wrong, and what the message must say

NAVIGATORS: dict[str, tuple[Callable[[], Any], str]] = {
    "no gyro sensor": (lambda: cc.StarGyroNavigator(cc.EKF()), r"gyro: is needed: Gyro\(arw="),
    "gyro is a number": (lambda: navigator(gyro=1e-6), r"gyro, value 1e-06: must be Gyro"),
    "star is a number": (lambda: navigator(star=1e-5), r"star, value 1e-05: must be StarCamera"),
    "star in a dict": (lambda: navigator(star={"star_1": 1e-5}), r"star_1, value 1e-05: must be"),
    "vector is a number": (lambda: navigator(vector=0.1), r"vector, value 0\.1: must be Vector"),
    "filter is a word": (lambda: navigator("ekf"), r"filter, value 'ekf': must be EKF.* or UKF"),
    "filter is a class": (lambda: navigator(cc.UKF), r"filter, value 'type': must be EKF"),
    "gate 0": (lambda: navigator(gate=0.0), r"gate, value 0\.0: must be greater than 0"),
    "gate below 0": (lambda: navigator(gate=-0.5), r"gate, value -0\.5"),
    "gate above 1": (lambda: navigator(gate=1.5), r"gate, value 1\.5: is a probability"),
    "gate 99.9": (lambda: navigator(gate=99.9), r"gate, value 99\.9: is a probability"),
    "gate nan": (lambda: navigator(gate=np.nan), r"gate, value nan: must be finite"),
    "gate is a word": (lambda: navigator(gate="0.9"), r"gate, value '0\.9'.*not real numbers"),
    "gates": (lambda: navigator(gate=[0.9, 0.9]), r"gate: must be one number"),
    "frames": (
        lambda: navigator(star={"a": CAMERA, "b": cc.StarCamera(1e-5, frame="bus")}),
        r"frame: .*gyro to 'body', a to 'body', b to 'bus'",
    ),
    "vector frame": (
        lambda: navigator(vector=cc.VectorSensor(0.1, frame="panel")),
        r"frame: .*vector to 'panel'",
    ),
    "arw 0": (lambda: cc.Gyro(0.0), r"gyro\.arw, value 0\.0: must be greater than 0"),
    "arw below 0": (lambda: cc.Gyro(-1e-6), r"gyro\.arw, value -1e-06"),
    "arw nan": (lambda: cc.Gyro(np.nan), r"gyro\.arw, value nan"),
    "rrw below 0": (lambda: cc.Gyro(1e-6, -1e-9), r"gyro\.rrw, value -1e-09: must be at least 0"),
    "sampling": (lambda: cc.Gyro(1e-6, sampling="mean"), r"gyro\.sampling, value 'mean'.*hold"),
    "max_gap": (lambda: cc.Gyro(1e-6, max_gap=0.0), r"gyro\.max_gap, value 0\.0"),
    "gap_rate_sigma": (lambda: cc.Gyro(1e-6, gap_rate_sigma=-1.0), r"gyro\.gap_rate_sigma"),
    "gyro mounting": (lambda: cc.Gyro(1e-6, mounting=[0.0] * 4), r"gyro\.mounting.*is zero"),
    "camera sigma": (lambda: cc.StarCamera(0.0), r"star\.sigma, value 0\.0: must be greater"),
    "camera covariance": (
        lambda: cc.StarCamera(covariance=-np.eye(3)),
        r"star\.covariance.*positive definite",
    ),
    "camera mounting": (lambda: cc.StarCamera(1e-5, mounting=[2.0, 0, 0, 0]), r"star\.mounting"),
    "integrator": (lambda: cc.EKF("euler"), r"filter\.integrator, value 'euler'.*exponential, rk4"),
    "ukf alpha 0": (lambda: cc.UKF(alpha=0.0), r"filter\.alpha, value 0\.0: must be in \(0, 1\]"),
    "ukf alpha 2": (lambda: cc.UKF(alpha=2.0), r"filter\.alpha, value 2\.0: must be in \(0, 1\]"),
    "ukf alpha nan": (lambda: cc.UKF(alpha=np.nan), r"filter\.alpha, value nan: must be finite"),
    "ukf beta": (lambda: cc.UKF(beta=-1.0), r"filter\.beta, value -1\.0: must be at least 0"),
    "ukf beta inf": (lambda: cc.UKF(beta=np.inf), r"filter\.beta, value inf: must be finite"),
    "ukf beta word": (lambda: cc.UKF(beta=cast("float", "2")), r"filter\.beta, value '2'"),
    "ukf kappa": (
        lambda: cc.UKF(kappa=-7.0),
        r"filter\.kappa, value -7\.0: must be greater than -6",
    ),
    "ukf kappa -6": (lambda: cc.UKF(kappa=-6.0), r"filter\.kappa, value -6\.0: must be greater"),
    "ukf kappa nan": (lambda: cc.UKF(kappa=np.nan), r"filter\.kappa, value nan: must be finite"),
    "ukf kappa true": (lambda: cc.UKF(kappa=True), r"filter\.kappa, value True"),
    "srukf beta": (lambda: cc.SRUKF(beta=0.5), r"filter\.beta, value 0\.5: .*alpha squared"),
    "srukf alpha": (lambda: cc.SRUKF(alpha=2.0), r"filter\.alpha, value 2\.0: must be in"),
}

RUNS: dict[str, tuple[Callable[[], Any], str]] = {
    "no log": (lambda: run(None), r"log.*must be SensorLog"),
    "a tuple": (lambda: run((T, RATE)), r"log.*must be SensorLog"),
    "no gyro": (lambda: run(cc.SensorLog(star=(T, Q))), r"no gyro table; it has star"),
    "no star fixes": (lambda: run(cc.SensorLog(gyro=(T, RATE))), r"no star camera.*give .*q0"),
    "only fixes outside": (
        lambda: run(cc.SensorLog(gyro=(T, RATE), star=(T + 49.5, Q))),
        r"no star camera.*inside the gyro's time span",
    ),
    "only directions": (
        lambda: run(cc.SensorLog(gyro=(T, RATE), vector_a=(T, RATE * 100, RATE * 100, 0.1))),
        r"no star camera.*give .*q0",
    ),
    "no noise": (lambda: run(nav={"star": cc.StarCamera()}), r"star\.sigma: .*StarCamera\(sigma"),
    "no noise of a direction": (
        lambda: run(cc.SensorLog(gyro=(T, RATE), vector_a=(T, RATE * 100, RATE * 100)), **START),
        r"vector_a\.sigma: has no noise.*VectorSensor\(sigma",
    ),
    "camera not described": (
        lambda: run(nav={"star": {"star_1": CAMERA}}),
        r"star: no star sensor is described for it; described are star_1",
    ),
    "no camera described": (lambda: run(nav={"star": {}}), r"star: .*described are none"),
    "direction not described": (
        lambda: run(
            cc.SensorLog(gyro=(T, RATE), vector_a=(T, RATE * 100, RATE * 100)),
            nav={"vector": {"b": cc.VectorSensor(0.1)}},
            **START,
        ),
        r"a: no vector sensor is described for it; described are b",
    ),
    # starts
    "t0 alone": (lambda: run(t0=1.0), r"t0, value 1\.0: goes with q0"),
    "t0 early": (lambda: run(t0=-1.0, **START), r"t0, value -1.*: .*gyro's time span"),
    "t0 late": (lambda: run(t0=49.1, **START), r"t0, value 49\.1.*0 to 49 s"),
    "t0 nan": (lambda: run(t0=np.nan, **START), r"t0, value nan: must be finite"),
    "t0 is a word": (lambda: run(t0="now", **START), r"t0, value 'now'"),
    "q0 alone": (lambda: run(q0=IDENTITY), r"sigma0: is needed with q0"),
    "q0 zero": (lambda: run(**{**START, "q0": [0.0] * 4}), r"q0, value .*is zero"),
    "q0 long": (lambda: run(**{**START, "q0": [1.01, 0, 0, 0]}), r"q0, value .*has norm 1\.01"),
    "q0 nan": (lambda: run(**{**START, "q0": [np.nan] * 4}), r"q0, value .*must be finite"),
    "q0 short": (lambda: run(**{**START, "q0": [1.0, 0, 0]}), r"q0: has shape \(3,\)"),
    "q0 rows": (lambda: run(**{**START, "q0": Q}), r"q0: needs one quaternion"),
    "q0 is a word": (lambda: run(**{**START, "q0": "up"}), r"q0, value 'up'"),
    "sigma0 one": (lambda: run(q0=IDENTITY, sigma0=1e-3), r"sigma0.*attitude \[rad\], bias"),
    "sigma0 one of two": (lambda: run(q0=IDENTITY, sigma0=(1e-3,)), r"sigma0.*attitude"),
    "sigma0 without q0": (lambda: run(sigma0=(1e-3,)), r"sigma0.*attitude"),
    "sigma0 zero": (lambda: run(q0=IDENTITY, sigma0=(0.0, 1e-4)), r"sigma0.*must be positive"),
    "sigma0 negative": (lambda: run(q0=IDENTITY, sigma0=(1e-3, -1e-4)), r"sigma0.*-0\.0001"),
    "sigma0 bias zero": (lambda: run(sigma0=(1e-3, 0.0)), r"sigma0.*must be positive"),
    "sigma0 bias negative": (lambda: run(sigma0=(1e-3, [1, -1, 1])), r"sigma0.*positive"),
    "sigma0 nan": (lambda: run(q0=IDENTITY, sigma0=(np.nan, 1e-4)), r"sigma0, value nan"),
    "sigma0 two": (lambda: run(q0=IDENTITY, sigma0=([1, 1], 1)), r"sigma0.*or three"),
    "sigma0 words": (lambda: run(q0=IDENTITY, sigma0=("a", "b")), r"sigma0, value 'a'"),
    "bias0 two": (lambda: run(bias0=[0.0, 0.0]), r"bias0.*or three"),
    "bias0 nan": (lambda: run(bias0=[0.0, 0.0, np.nan]), r"bias0.*finite"),
    # output
    "every 0": (lambda: run(every=0), r"every, value 0: must be a whole number of at least 1"),
    "every -1": (lambda: run(every=-1), r"every, value -1"),
    "every 1.5": (lambda: run(every=1.5), r"every, value 1\.5: must be a whole number"),
    "every nan": (lambda: run(every=np.nan), r"every, value nan"),
    "every inf": (lambda: run(every=np.inf), r"every, value inf"),
    "every none": (lambda: run(every=None), r"every"),
    "every word": (lambda: run(every="all"), r"every, value 'all'"),
    "every true": (lambda: run(every=True), r"every, value True"),
    "period 0": (lambda: run(period=0.0), r"period, value 0\.0: must be greater than 0"),
    "period -1": (lambda: run(period=-1.0), r"period, value -1\.0"),
    "period nan": (lambda: run(period=np.nan), r"period, value nan"),
    "period inf": (lambda: run(period=np.inf), r"period, value inf"),
    "period word": (lambda: run(period="1s"), r"period, value '1s'"),
    "period tiny": (lambda: run(period=1e-300), r"^period\W.* 1e-300: .*too short"),
    # numbers that break the arithmetic
    "sigma0 underflows": (lambda: run(q0=IDENTITY, sigma0=(1e-200, 1e-4)), r"initial covariance"),
    "bias0 overflows": (lambda: run(bias0=[1e300] * 3), r"step 0.* 1 s"),
}


@pytest.mark.parametrize("case", [*NAVIGATORS, *RUNS])
def test_bad_input_says_what_and_where(case: str) -> None:
    call, message = {**NAVIGATORS, **RUNS}[case]
    with pytest.raises(cc.CelestcoreError, match=message) as caught:
        call()
    assert len(str(caught.value)) < 300


def test_tables_have_no_name_twice() -> None:
    assert not set(NAVIGATORS) & set(RUNS)


@pytest.mark.parametrize("name", FILTERS)
def test_numerical_error_says_when(name: str) -> None:
    log = cc.SensorLog(gyro=(T, put(RATE, 7, [1e300, 0.0, 0.0])), star=(T[::2], Q[::2]))
    with pytest.raises(cc.NumericalError, match=r"step 7\b.* 8 s") as caught:
        run(log, FILTERS[name])
    assert isinstance(caught.value, ArithmeticError)
    assert (caught.value.step, caught.value.time) == (7, 8.0)


def test_input_errors_are_value_errors_and_carry_their_field() -> None:
    for case, field in (("gate nan", "gate"), ("sigma0 zero", "sigma0"), ("q0 zero", "q0")):
        with pytest.raises(ValueError, match=field) as caught:
            {**NAVIGATORS, **RUNS}[case][0]()
        assert isinstance(caught.value, cc.InputError)
        assert caught.value.field == field
        assert caught.value.row is None
        assert caught.value.value is not None


@pytest.mark.parametrize(
    ("case", "field", "value"),
    [("t0 late", "t0", 49.1), ("period tiny", "period", 1e-300)],
)
def test_errors_of_the_core_carry_their_field(case: str, field: str, value: float) -> None:
    with pytest.raises(cc.InputError) as caught:
        RUNS[case][0]()
    assert caught.value.field == field
    assert caught.value.value == value


def test_one_sample_and_one_fix_are_no_error() -> None:
    for options in ({}, START):
        log = cc.SensorLog(gyro=([0.0], [[0.0, 0.0, 0.1]]), star=([0.0], [IDENTITY]))
        assert len(run(log, **options)) == 1
    only = cc.SensorLog(gyro=([0.0], [[0.0, 0.0, 0.1]]), star=([1.0], [IDENTITY]))
    with pytest.raises(cc.InputError, match="no star camera"):
        run(only)


def test_every_of_any_size() -> None:
    for every in (10**6, 2**63, 10**30, 3.0, np.int8(3)):
        assert np.array_equal(run(every=every).t, T[:: min(int(every), 100)])


def test_a_failed_run_leaves_the_navigator_usable() -> None:
    nav = navigator(cc.UKF())
    expected = nav.run(LOG)
    with pytest.raises(cc.NumericalError):
        nav.run(cc.SensorLog(gyro=(T, put(RATE, 7, 1e300)), star=(T, Q)))
    assert np.array_equal(nav.run(LOG).q, expected.q)


def test_progress_must_be_callable() -> None:
    with pytest.raises(cc.InputError, match="progress: must be callable"):
        run(progress=3)


def python(code: str, timeout: float = 60.0) -> subprocess.CompletedProcess[str]:
    """Run a script in a process of its own, whose end would not be ours."""
    return subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code)],
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
        env={**os.environ, "RUST_BACKTRACE": "0"},
    )


def test_rows_that_no_memory_holds_are_an_error() -> None:
    done = python(
        """
        import celestcore as cc
        log = cc.SensorLog(gyro=([0.0, 90.0], [[0.0] * 3] * 2), star=([0.0], [[1.0, 0, 0, 0]]))
        nav = cc.StarGyroNavigator(gyro=cc.Gyro(1e-6), star=cc.StarCamera(1e-5))
        try:
            nav.run(log, period=1e-8, covariance=True)
        except (cc.CelestcoreError, MemoryError) as error:
            print("good:", error)
        """
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("good:"), done.stderr
    assert "panicked" not in done.stderr


def test_period_too_short_to_move_the_time_is_an_error() -> None:
    done = python(
        """
        import celestcore as cc
        log = cc.SensorLog(gyro=([1e6], [[0.0] * 3]), star=([1e6], [[1.0, 0, 0, 0]]))
        nav = cc.StarGyroNavigator(gyro=cc.Gyro(1e-6), star=cc.StarCamera(1e-5))
        for period in (1e-12, 1e-300):
            try:
                nav.run(log, period=period)
            except cc.InputError as error:
                print(error)
        """,
        timeout=10,
    )
    assert done.stdout.count("period") == 2, done.stderr


# odd arrays: whatever goes in, only errors of the family come out

ERRORS = (cc.CelestcoreError, ValueError, TypeError)
odd_floats = st.one_of(
    st.floats(width=64),
    st.sampled_from([0.0, -0.0, 1.0, -1.0, 5e-324, 1e-300, 1e300, 1e160, np.inf, np.nan]),
)
ODD_DTYPES = ["f8", ">f8", "f4", "f2", "i8", "u1", "?", "c16", "U3", "S2", "M8[s]", "O"]


@st.composite
def odd_arrays(draw: st.DrawFn) -> Any:
    """Return an array of a shape and type that may or may not fit."""
    shape = draw(
        st.one_of(
            st.sampled_from([(3,), (4,), (2, 3), (2, 4), (3, 3), (2, 3, 3), (2, 2, 4), (1,), ()]),
            hnp.array_shapes(min_dims=0, max_dims=3, min_side=0, max_side=4),
        )
    )
    if draw(st.integers(0, 3)):
        return draw(hnp.arrays("f8", shape, elements=odd_floats))
    kind = draw(st.sampled_from(ODD_DTYPES))
    if kind == "O":
        things = st.one_of(odd_floats, st.none(), st.text(max_size=2), st.integers())
        return draw(hnp.arrays(object, shape, elements=things))
    return draw(hnp.arrays(np.dtype(kind), shape))


FUNCTIONS: dict[str, tuple[Callable[..., Any], int]] = {
    "multiply": (quat.multiply, 2),
    "conjugate": (quat.conjugate, 1),
    "rotate": (quat.rotate, 2),
    "exp": (quat.exp, 1),
    "log": (quat.log, 1),
    "to_matrix": (quat.to_matrix, 1),
    "from_matrix": (quat.from_matrix, 1),
    "angle_between": (quat.angle_between, 2),
    "slerp": (quat.slerp, 3),
    "right_jacobian": (quat.right_jacobian, 1),
    "right_jacobian_inverse": (quat.right_jacobian_inverse, 1),
    "shortest_rotation": (quat.shortest_rotation, 2),
    "continuous": (quat.continuous, 1),
    "propagate": (quat.propagate, 3),
}
ODD = settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))


@pytest.mark.parametrize("name", FUNCTIONS)
@ODD
@given(data=st.data())
def test_quaternion_functions_take_anything(name: str, data: st.DataObject) -> None:
    function, count = FUNCTIONS[name]
    arguments = [data.draw(odd_arrays()) for _ in range(count)]
    try:
        out = function(*arguments)
    except ERRORS:
        return
    assert isinstance(out, np.ndarray)
    assert out.dtype == np.float64


def mostly(good: st.SearchStrategy[Any], odd: st.SearchStrategy[Any]) -> st.SearchStrategy[Any]:
    """Return good values, and odd ones now and then: one odd thing at a time goes deepest."""
    return st.integers(0, 11).flatmap(lambda k: odd if k == 7 else good)


small = st.floats(-1.0, 1.0)
times = mostly(
    st.lists(st.floats(1e-3, 20.0), min_size=0, max_size=6).map(lambda s: np.cumsum([0.0, *s])),
    st.builds(
        lambda first, scale, n: first + scale * np.arange(n),
        st.sampled_from([0.0, -1.0, 1e9]),
        st.sampled_from([5e-324, 1e-300, 1e-100, 1e-7, 1e9, 1e150, 1e300]),
        st.integers(1, 6),
    ),
)


@st.composite
def odd_tables(draw: st.DrawFn) -> dict[str, Any]:
    """Return tables that mostly make a log, with numbers of any size."""
    t = draw(times)
    n = len(t)
    rate = draw(
        mostly(
            hnp.arrays("f8", (n, 3), elements=small), hnp.arrays("f8", (n, 3), elements=odd_floats)
        )
    )
    tables: dict[str, Any] = {"gyro": (t, rate)}
    for name in draw(mostly(st.sampled_from([["star"], ["star", "star_1"]]), st.just([]))):
        v = draw(hnp.arrays("f8", (n, 3), elements=st.floats(-4.0, 4.0)))
        noise = draw(mostly(st.none(), st.sampled_from([1e-300, 1e-170, 1e-9, 1.0, 1e200])))
        q = quat.exp(v) * draw(st.sampled_from([1.0, -1.0, 1.0009]))
        shift = draw(st.sampled_from([0.0, 0.5, 1e-9]))
        tables[name] = (t + shift, q) if noise is None else (t + shift, q, noise)
    if draw(st.booleans()):
        b = np.eye(3)[np.arange(n) % 3]
        sign = draw(st.sampled_from([1.0, -1.0]))
        sigma = draw(mostly(st.just(1e-3), st.sampled_from([1e-300, 1e-9, 1e300])))
        tables["vector_a"] = (t, b, sign * b, sigma)
    return tables


@st.composite
def options(draw: st.DrawFn) -> dict[str, Any]:
    out: dict[str, Any] = {"covariance": draw(st.booleans()), "portable": draw(st.booleans())}
    if draw(st.booleans()):
        out["q0"] = draw(mostly(st.just(np.array(IDENTITY)), odd_arrays()))
        pair = st.tuples(odd_floats, odd_floats)
        out["sigma0"] = draw(mostly(st.just((1e-3, 1e-4)), st.one_of(pair, odd_arrays())))
        out["t0"] = draw(mostly(st.none(), odd_floats))
    out["bias0"] = draw(mostly(st.just(0.0), odd_arrays()))
    if draw(st.booleans()):
        out["every"] = draw(mostly(st.integers(1, 8), st.one_of(odd_floats, st.just(2**70))))
    else:
        out["parts"] = draw(mostly(st.floats(0.1, 50.0), st.sampled_from([1e-300, -1.0, np.nan])))
    return out


gyros = st.builds(
    dict,
    arw=mostly(st.just(1e-6), st.sampled_from([1e-300, 1e-3, 1e200])),
    rrw=mostly(st.just(1e-9), st.sampled_from([0.0, 1e-300, 1e200])),
    sampling=st.sampled_from(["hold", "integrated", "average"]),
    max_gap=st.sampled_from([None, 1e-300, 1.0, 1e300]),
    gap_rate_sigma=mostly(st.just(1e-3), st.sampled_from([0.0, 1e300])),
)
filters = mostly(
    st.sampled_from([*FILTERS.values(), cc.EKF("rk4"), cc.SRUKF(integrator="rk4")]),
    st.builds(
        cc.UKF,
        alpha=st.floats(0.0, 1.0, exclude_min=True),
        beta=st.floats(0.0, 1e308),
        kappa=st.floats(-6.0, 1e308, exclude_min=True),
    ),
)


@settings(max_examples=200, deadline=None, suppress_health_check=list(HealthCheck))
@given(
    tables=odd_tables(),
    kind=filters,
    gyro=gyros,
    gate=st.sampled_from([None, 1e-300, 0.5, 0.9999, 1.0 - 1e-16]),
    chosen=options(),
)
def test_navigator_takes_anything(
    tables: dict[str, Any], kind: Any, gyro: dict[str, Any], gate: Any, chosen: dict[str, Any]
) -> None:
    if "parts" in chosen:
        t = tables["gyro"][0]
        with np.errstate(all="ignore"):
            chosen["period"] = (t[-1] - t[0] if len(t) > 1 else 1.0) / chosen.pop("parts")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.CelestcoreWarning)
        try:
            log = cc.SensorLog(**tables)
            nav = navigator(kind, gyro=cc.Gyro(**gyro), vector=cc.VectorSensor(1e-3), gate=gate)
            sol = nav.run(log, **chosen)
        except ERRORS:
            return
    assert np.isfinite(sol.q).all()
    assert np.abs(np.linalg.norm(sol.q, axis=1) - 1.0).max(initial=0.0) < 1e-9
    assert np.isfinite(sol.sigma).all()
    assert np.all(sol.sigma >= 0.0)
    assert np.isfinite(sol.bias).all()
    assert np.isfinite(sol.nis).all()


@settings(max_examples=60, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data(), kind=filters)
def test_stream_takes_anything(data: st.DataObject, kind: Any) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", cc.CelestcoreWarning)
        nav = navigator(kind, vector=cc.VectorSensor(1e-3))
        try:
            state = nav.start(0.0, IDENTITY)
        except ERRORS:
            return
        for _ in range(data.draw(st.integers(1, 6))):
            what = data.draw(st.sampled_from(["predict", "update", "direction", "good"]))
            t = data.draw(st.one_of(odd_floats, st.floats(state.t, state.t + 10.0)))
            a, b = data.draw(odd_arrays()), data.draw(odd_arrays())
            before = (state.t, state.q.tolist(), state.bias.tolist())
            try:
                if what == "predict":
                    state.predict(t, a)
                elif what == "update":
                    state.update(t, a, covariance=b)
                elif what == "direction":
                    state.update_direction(t, a, b)
                else:
                    state.predict(t, [1e-3, 0.0, 0.0])
                    state.update(t, IDENTITY)
            except ERRORS:
                if what != "good":
                    assert before == (state.t, state.q.tolist(), state.bias.tolist())
            assert np.isfinite(state.q).all()
            assert abs(np.linalg.norm(state.q) - 1.0) < 1e-9
            assert np.isfinite(state.covariance).all()
