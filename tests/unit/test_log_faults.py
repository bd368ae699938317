"""SensorLog and bad input: every error names the field, the row and the value."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from celestcore.errors import CelestcoreError, InputError
from celestcore.log import SensorLog
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

Array = np.ndarray[Any, Any]
IDENTITY = [1.0, 0.0, 0.0, 0.0]
T = np.arange(6.0)
RATE = np.linspace(0.0, 1e-3, 18).reshape(6, 3)
Q = np.tile(IDENTITY, (6, 1))
B = np.tile([0.0, 0.0, 1.0], (6, 1))
R = np.tile([7e6, 0.0, 0.0], (6, 1))


def put(a: Array, row: int, value: object) -> Array:
    """Return a copy with one row, or its first element, changed."""
    out = np.array(a)
    out[row] = value
    return out


SKEW = 1e-10 * (np.eye(3) + np.eye(3, k=1))
COVARIANCES = np.tile(1e-10 * np.eye(3), (6, 1, 1))

BAD: dict[str, tuple[dict[str, Any], str, int | None, str]] = {
    # times
    "nan time": ({"gyro": (put(T, 2, np.nan), RATE)}, "gyro.t", 2, "finite"),
    "inf last time": ({"gyro": (put(T, 5, np.inf), RATE)}, "gyro.t", 5, "finite"),
    "inf first time": ({"gyro": (put(T, 0, -np.inf), RATE)}, "gyro.t", 0, "finite"),
    "nan only time": ({"gyro": ([np.nan], [[0, 0, 0]])}, "gyro.t", 0, "finite"),
    "masked time": ({"gyro": (np.ma.masked_equal(T, 3.0), RATE)}, "gyro.t", 3, "finite"),
    "repeated": ({"gyro": (put(T, 3, 2.0), RATE)}, "gyro.t", 3, "repeats row 2 (2.0)"),
    "back": (
        {"gyro": (put(T, 3, 0.5), RATE)},
        "gyro.t",
        3,
        "goes back, it is before row 2 (2.0)",
    ),
    "back in star": ({"star_1": (T[::-1], Q)}, "star_1.t", 1, "goes back"),
    "dates": ({"gyro": (T.astype("M8[s]"), RATE)}, "gyro.t", None, "seconds since"),
    "scalar time": ({"gyro": (0.0, RATE[0])}, "gyro.t", None, "one row per sample"),
    "two-dimensional time": ({"gyro": (RATE, RATE)}, "gyro.t", None, "needed is (n,)"),
    # shapes and types
    "lengths": ({"gyro": (T, RATE[:5])}, "gyro.rate", None, "5 rows but gyro.t has 6"),
    "star lengths": ({"star": (T[:5], Q)}, "star.q", None, "6 rows but star.t has 5"),
    "vector lengths": ({"vector_a": (T, B, B[1:])}, "vector_a.inertial", None, "5 rows"),
    "sigma length": ({"vector_a": (T, B, B, [1.0])}, "vector_a.sigma", None, "1 rows"),
    "velocity length": ({"gnss": (T, R, R[1:])}, "gnss.v", None, "5 rows"),
    "transposed": ({"gyro": (T, RATE.T)}, "gyro.rate", None, "transpose"),
    "one rate": ({"gyro": ([0.0], RATE[0])}, "gyro.rate", None, "one row per sample"),
    "three columns": ({"star": (T, RATE)}, "star.q", None, "4 columns"),
    "one quaternion": ({"star": ([0.0], IDENTITY)}, "star.q", None, "(n, 4)"),
    "one rotation": ({"star": ([0.0], Rotation.identity())}, "star.q", None, "(n, 4)"),
    "scalar quaternion": ({"star": (T, 1.0)}, "star.q", None, "4 columns"),
    "ragged": ({"gyro": (T, [[1.0, 2.0], [3.0]])}, "gyro.rate", None, "same number of columns"),
    "text": ({"gyro": (T, np.full((6, 3), "1.0"))}, "gyro.rate", None, "not real numbers"),
    "complex": ({"gyro": (T, RATE * 1j)}, "gyro.rate", None, "not real numbers"),
    "truth values": ({"gyro": (T, RATE > 0)}, "gyro.rate", None, "not real numbers"),
    "text in objects": (
        {"gyro": (T, put(RATE.astype(object), 4, "0.1"))},
        "gyro.rate",
        4,
        "not a real number",
    ),
    "no tuple": ({"gyro": RATE}, "gyro", None, "must be a tuple (t, rate)"),
    "too few parts": ({"vector_a": (T, B)}, "vector_a", None, "t, body, inertial"),
    "too many parts": ({"gyro": (T, RATE, RATE, RATE)}, "gyro", None, "got 4 parts"),
    "a part is None": ({"gyro": (T, None)}, "gyro", None, "None"),
    # empty
    "nothing": ({}, "", None, "the log is empty"),
    "no rows": ({"gyro": ([], np.empty((0, 3)))}, "gyro.t", None, "is empty"),
    "no rows, list": ({"star": ([], [])}, "star.t", None, "is empty"),
    "all missing": ({"star": (T, Q * np.nan)}, "star", None, "all 6 rows are missing"),
    # quaternions and unit vectors
    "norm": ({"star": (T, put(Q, 2, [1.0011, 0, 0, 0]))}, "star.q", 2, "norm 1.0011"),
    "short": ({"star": (T, put(Q, 2, [0.9989, 0, 0, 0]))}, "star.q", 2, "norm 0.9989"),
    "zero": ({"star": (T, put(Q, 2, 0.0))}, "star.q", 2, "zero"),
    "huge": ({"star": (T, put(Q, 2, 1e200))}, "star.q", 2, "unit quaternion"),
    "body not unit": ({"vector_a": (T, put(B, 1, [0, 0, 2]), B)}, "vector_a.body", 1, "norm 2"),
    "inertial zero": ({"vector_a": (T, B, put(B, 1, 0))}, "vector_a.inertial", 1, "zero"),
    # noise
    "zero sigma": ({"star": (T, Q, put(np.ones(6), 4, 0.0))}, "star.sigma", 4, "positive"),
    "negative": ({"star": (T, Q, -1e-5)}, "star.sigma", None, "greater than 0"),
    "nan sigma": ({"star": (T, Q, put(RATE + 1e-5, 1, np.nan))}, "star.sigma", 1, "finite"),
    "sigma shape": ({"star": (T, Q, [1e-5, 1e-5, 1e-5])}, "star.sigma", None, "StarCamera"),
    "skew": ({"star": (T, Q, put(COVARIANCES, 3, SKEW))}, "star.covariance", 3, "symmetric"),
    "indefinite": (
        {"star": (T, Q, put(COVARIANCES, 3, [[1, 2, 0], [2, 1, 0], [0, 0, 1]]))},
        "star.covariance",
        3,
        "positive definite",
    ),
    "singular": (
        {"star": (T, Q, put(COVARIANCES, 3, np.ones((3, 3))))},
        "star.covariance",
        3,
        "positive definite",
    ),
    "zero noise": ({"star": (T, Q, put(COVARIANCES, 3, 0))}, "star.covariance", 3, "positive"),
    "nan covariance": (
        {"star": (T, Q, put(COVARIANCES, 3, np.nan))},
        "star.covariance",
        3,
        "finite",
    ),
    "vector sigma": ({"vector_a": (T, B, B, put(T + 0.1, 2, 0))}, "vector_a.sigma", 2, "positive"),
    # names and settings
    "unknown table": ({"stars": (T, Q)}, "stars", None, "known are gyro, star, star_NAME"),
    "unknown None": ({"sun": None}, "sun", None, "known are"),
    "odd name": ({"star_a b": (T, Q)}, "star_a b", None, "known are"),
    "settings": ({"gyro": (T, RATE), "settings": {"gyro": {"arv": 1}}}, "gyro.arv", None, "known"),
    "frames": ({"gyro": (T, RATE), "frames": {"inertal": "GCRS"}}, "frames.inertal", None, "known"),
    "frame type": ({"gyro": (T, RATE), "frames": {"body": 3}}, "frames.body", None, "text"),
}


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("name", BAD)
def test_bad_input_names_field_and_row(name: str) -> None:
    kwargs, field, row, part = BAD[name]
    with pytest.raises(InputError) as caught:
        SensorLog(**kwargs)
    error = caught.value
    assert isinstance(error, CelestcoreError)
    assert isinstance(error, ValueError)
    assert (error.field or "") == field
    assert error.row == row
    text = str(error)
    assert text.startswith(field)
    assert part in text
    assert "np." not in text
    if row is not None:
        assert f"row {row}" in text
        assert error.value is not None
        assert "value" in text


def test_a_failed_log_leaves_its_input_alone() -> None:
    t, q = T.copy(), put(Q * 1.0005, 5, 0.0)
    before = q.copy()
    with pytest.raises(InputError):
        SensorLog(star=(t, q))
    assert np.array_equal(q, before)
    assert q.flags.writeable


any_float = st.floats(allow_nan=True, allow_infinity=True)
some_times = st.one_of(
    hnp.arrays(np.float64, 5, elements=any_float),
    st.lists(st.floats(-1e9, 1e9), min_size=5, max_size=5, unique=True).map(sorted),
)


@pytest.mark.filterwarnings("error", "ignore::celestcore.errors.CelestcoreWarning")
@given(hnp.arrays(np.float64, (5, 3), elements=any_float), some_times)
def test_whatever_comes_in_is_a_good_log_or_an_input_error(rate: Array, t: Any) -> None:
    times_are_good = bool(np.isfinite(t).all() and (np.asarray(t[1:]) > np.asarray(t[:-1])).all())
    any_is_good = bool(np.isfinite(rate).all(axis=1).any())
    try:
        log = SensorLog(gyro=(t, rate))
    except InputError:
        assert not (times_are_good and any_is_good)
        return
    assert times_are_good
    assert any_is_good
    assert log.gyro is not None
    assert np.isfinite(log.gyro.t).all()
    assert np.isfinite(log.gyro.rate).all()
    assert (np.diff(log.gyro.t) > 0).all()
    assert len(log.gyro) + log.gyro.missing == 5
    assert np.array_equal(log.gyro.rate, rate[log.gyro.rows])
