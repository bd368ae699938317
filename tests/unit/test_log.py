"""SensorLog: what it accepts, how it stores it, and what it says about bad input."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import datetime, timedelta, timezone
from typing import Any

import numpy as np
import pandas as pd
import pytest
from astropy.time import Time
from celestcore._tables import build_table
from celestcore.config import Settings
from celestcore.errors import CelestcoreWarning, InputError
from celestcore.log import SensorLog
from celestcore.units import ARCSEC, DEG
from hypothesis import assume, given
from hypothesis import strategies as st
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


def random_q(n: int, seed: int = 0) -> Array:
    q = np.random.default_rng(seed).standard_normal((n, 4))
    return np.asarray(q / np.linalg.norm(q, axis=1)[:, None])


# ------------------------------------------------------------------ what is stored


def test_tables_and_summary() -> None:
    log = SensorLog(
        epoch="2026-01-01T00:00:00",
        gyro=(T, RATE),
        star=(T[::2], Q[::2]),
        star_2=(T[:1] - 1.0, Q[:1], 5 * ARCSEC),
        vector_sun=(T, B, B, 0.01),
        gnss=(T + 3.0, R, R * 1e-3),
        title="six samples",
        frames={"inertial": "GCRS"},
    )
    assert list(log.tables) == ["gyro", "star", "star_2", "vector_sun", "gnss"]
    assert list(log.stars) == ["star", "star_2"]
    assert list(log.vectors) == ["sun"]
    assert log.gyro is not None
    assert log.gnss is not None
    assert log.gnss.v is not None
    assert np.array_equal(log.gyro.rate, RATE)
    assert np.array_equal(log.stars["star"].t, T[::2])
    assert np.array_equal(np.asarray(log.stars["star_2"].sigma), [[5 * ARCSEC] * 3])
    assert np.array_equal(np.asarray(log.vectors["sun"].sigma), np.full(6, 0.01))
    assert log.span == (-1.0, 8.0)
    assert len(log) == 22
    assert log.frames == {"inertial": "GCRS"}
    assert repr(log) == (
        "SensorLog('six samples', 9 s from 2026-01-01T00:00:00: gyro 6 rows, star 3 rows, "
        "star_2 1 row, vector_sun 6 rows, gnss 6 rows)"
    )


def test_arrays_are_fresh_c_ordered_float64_and_read_only() -> None:
    t, rate = T.copy(), np.asfortranarray(RATE)
    log = SensorLog(gyro=(t, rate), star=(t, Q, np.full((6, 3), 1e-5)))
    for table in log.tables.values():
        for value in vars(table).values():
            if isinstance(value, np.ndarray):
                assert value.dtype == np.float64
                assert value.dtype.isnative
                assert value.flags.c_contiguous
                assert not value.flags.writeable
                assert not any(np.shares_memory(value, a) for a in (t, rate, Q))
    t[0], rate[0, 0] = -9.0, -9.0
    assert log.gyro is not None
    assert log.gyro.t[0] == 0.0
    assert log.gyro.rate[0, 0] == 0.0


VARIANTS: dict[str, Callable[[Array], Any]] = {
    "list": lambda a: a.tolist(),
    "tuple": lambda a: tuple(map(tuple, a.tolist())) if a.ndim > 1 else tuple(a.tolist()),
    "fortran": np.asfortranarray,
    "strided": lambda a: np.repeat(a, 3, axis=0)[::3],
    "reversed": lambda a: a[::-1].copy()[::-1],
    "big-endian": lambda a: a.astype(">f8"),
    "float128": lambda a: a.astype(np.longdouble),
    "object": lambda a: a.astype(object),
    "read-only": lambda a: np.broadcast_to(a, a.shape),
    "masked": np.ma.masked_invalid,
    "pandas": lambda a: pd.DataFrame(a) if a.ndim > 1 else pd.Series(a, index=a + 10),
    "pandas nullable": lambda a: (
        pd.DataFrame(a).astype("Float64") if a.ndim > 1 else pd.Series(a, dtype="Float64")
    ),
    "array protocol": lambda a: type("Own", (), {"__array__": lambda *_, **__: a})(),
}


@pytest.mark.parametrize("name", VARIANTS)
def test_anything_numpy_takes_gives_the_same_log(name: str) -> None:
    make = VARIANTS[name]
    q = random_q(6)
    given_log = SensorLog(
        gyro=(make(T), make(RATE)), star=(make(T), make(q)), vector_a=(make(T), make(B), make(B))
    )
    plain = SensorLog(gyro=(T, RATE), star=(T, q), vector_a=(T, B, B))
    for a, b in zip(given_log.tables.values(), plain.tables.values(), strict=True):
        for key, value in vars(b).items():
            assert np.array_equal(vars(a)[key], value)


@pytest.mark.parametrize("dtype", ["i1", "u2", ">i4", "<f4", ">f4", "f2"])
def test_other_dtypes(dtype: str) -> None:
    log = SensorLog(gyro=(np.arange(3).astype(dtype), np.eye(3).astype(dtype)))
    assert log.gyro is not None
    assert np.array_equal(log.gyro.rate, np.eye(3))


def test_length_one() -> None:
    log = SensorLog(gyro=([0], [[0, 0, 0]]), star=([0], [IDENTITY]))
    assert log.span == (0.0, 0.0)
    assert len(log) == 2


def test_scipy_rotation_and_scalar_last() -> None:
    q = random_q(6)
    rotation = Rotation.from_quat(np.roll(q, -1, axis=1))
    for log in (
        SensorLog(star=(T, rotation)),
        SensorLog(star=(T, rotation), scalar_first=False),
        SensorLog(star=(T, np.roll(q, -1, axis=1)), scalar_first=False),
    ):
        assert np.allclose(log.stars["star"].q, q, atol=1e-15)


def test_a_single_vector_sensor_is_short_for_vector_1() -> None:
    assert list(SensorLog(vector=(T, B, B)).vectors) == ["1"]
    with pytest.raises(InputError, match="vector_1"):
        SensorLog(vector=(T, B, B), vector_1=(T, B, B))


def test_named_columns_and_other_logs() -> None:
    columns = {"t": T, "wx": RATE[:, 0], "wy": RATE[:, 1], "wz": RATE[:, 2]}
    log = SensorLog(gyro=columns, star=(T, put(Q, 2, np.nan)))
    again = SensorLog(gyro=pd.DataFrame(columns), star=log.stars["star"])
    assert again.gyro is not None
    assert np.array_equal(again.gyro.rate, RATE)
    assert again.stars["star"].missing == 1
    assert again.stars["star"].rows.tolist() == [0, 1, 3, 4, 5]
    with pytest.raises(InputError, match=r"wz missing; found: t, wx, wy$"):
        SensorLog(gyro={k: columns[k] for k in ("t", "wx", "wy")})


@pytest.mark.parametrize(
    ("given_epoch", "stored"),
    [
        ("2026-01-01T00:00:00", "2026-01-01T00:00:00"),
        ("2026-01-01", "2026-01-01"),
        ("2016-12-31T23:59:60Z", "2016-12-31T23:59:60Z"),
        ("2026-01-01 00:00:00.123456789 TAI", "2026-01-01 00:00:00.123456789 TAI"),
        (datetime(2026, 1, 1), "2026-01-01T00:00:00"),
        (
            datetime(2026, 1, 1, 2, tzinfo=timezone(timedelta(hours=2))),
            "2026-01-01T00:00:00",
        ),
        (np.datetime64("2026-01-01T00:00:00"), "2026-01-01T00:00:00"),
        (Time("2026-01-01T00:00:37", scale="tai"), "2026-01-01T00:00:00.000000000"),
        (None, None),
    ],
)
def test_epochs(given_epoch: Any, stored: str | None) -> None:
    assert SensorLog(epoch=given_epoch, gyro=(T, RATE)).epoch == stored


@pytest.mark.parametrize(
    "bad", ["yesterday", "2026-13-01", "2026-02-30T00:00:00", "2026-01-01T25:00", 5.0, b"x", ""]
)
def test_bad_epochs(bad: Any) -> None:
    with pytest.raises(InputError) as caught:
        SensorLog(epoch=bad, gyro=(T, RATE))
    assert caught.value.field == "epoch"


# ------------------------------------------------------------------ missing measurements


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("row", [0, 3, 5])
def test_missing_measurements_are_dropped_and_counted(bad: float, row: int) -> None:
    rest = np.delete(np.arange(6), row)
    log = SensorLog(
        gyro=(T, put(RATE, row, [0.0, bad, 0.0])),
        star=(T, put(random_q(6), row, bad), np.full(6, 1e-5)),
        vector_a=(T, put(B, row, bad), B, np.full(6, 0.1)),
        vector_b=(T, B, put(B, row, bad)),
        gnss=(T, R, put(R, row, [bad, 0.0, 0.0])),
    )
    for table in log.tables.values():
        assert table.missing == 1
        assert np.array_equal(table.rows, rest)
        assert np.array_equal(table.t, T[rest])
        assert all(len(v) == 5 for v in vars(table).values() if isinstance(v, np.ndarray))
    assert log.missing == 5
    assert "gyro 5 rows (1 missing)" in repr(log)


def test_none_masked_and_pandas_na_are_missing() -> None:
    masked = np.ma.MaskedArray(RATE, mask=put(np.zeros_like(RATE, dtype=bool), 1, True))
    objects = put(RATE.astype(object), 1, None)
    frame = pd.DataFrame(RATE).astype("Float64")
    frame.iloc[1, 2] = pd.NA
    integers = np.ma.MaskedArray(np.arange(18).reshape(6, 3), mask=masked.mask)
    for rate in (
        masked,
        objects,
        frame,
        integers,
        RATE.tolist()[:1] + [[None] * 3] + [[0] * 3] * 4,
    ):
        log = SensorLog(gyro=(T, rate))
        assert log.gyro is not None
        assert log.gyro.missing == 1
        assert log.gyro.rows.tolist() == [0, 2, 3, 4, 5]


def test_infinities_that_cancel_are_seen() -> None:
    log = SensorLog(gyro=(T, put(put(RATE, 0, np.inf), 1, -np.inf)))
    assert log.gyro is not None
    assert log.gyro.missing == 2


def test_huge_but_finite_measurements_are_not_missing() -> None:
    log = SensorLog(gyro=(T, np.full((6, 3), 1.7e308)))
    assert log.gyro is not None
    assert log.gyro.missing == 0


def test_row_numbers_in_errors_count_missing_rows() -> None:
    q = put(put(Q, 1, np.nan), 4, [2.0, 0.0, 0.0, 0.0])
    with pytest.raises(InputError) as caught:
        SensorLog(star=(T, q))
    assert caught.value.row == 4


# ------------------------------------------------------------------ normalising


@given(st.integers(0, 2**32 - 1), st.floats(-9.9e-4, 9.9e-4), st.sampled_from([-1.0, 1.0]))
def test_small_norm_errors_are_normalised_once(seed: int, off: float, sign: float) -> None:
    q = random_q(20, seed)
    once = SensorLog(star=(np.arange(20), sign * q * (1.0 + off))).stars["star"].q
    assert np.allclose(once, sign * q, atol=1e-15)
    assert np.all(np.abs(np.linalg.norm(once, axis=1) - 1.0) < 1e-15)
    twice = SensorLog(star=(np.arange(20), once)).stars["star"].q
    assert np.array_equal(once, twice)


COVARIANCES = np.tile(1e-10 * np.eye(3), (6, 1, 1))


def test_covariances_nearly_symmetric_become_so() -> None:
    c = COVARIANCES + 1e-11
    c[:, 0, 1] *= 1.0 + 1e-12
    stored = SensorLog(star=(T, Q, c)).stars["star"]
    assert stored.sigma is None
    assert stored.noise is stored.covariance
    assert stored.covariance is not None
    assert np.array_equal(stored.covariance, stored.covariance.transpose(0, 2, 1))
    assert np.allclose(stored.covariance, c, rtol=1e-11)


@given(st.integers(0, 2**32 - 1), st.floats(-200.0, 150.0))
def test_definiteness_agrees_with_eigenvalues(seed: int, exponent: float) -> None:
    rng = np.random.default_rng(seed)
    c = rng.standard_normal((3, 3))
    c = (c + c.T) / 2 + np.diag(rng.uniform(0, 3, 3))
    smallest = np.linalg.eigvalsh(c)[0]
    assume(abs(smallest) > 1e-6)
    try:
        SensorLog(star=([0.0], [IDENTITY], [c * 10.0**exponent]))
    except InputError:
        assert smallest < 0.0
    else:
        assert smallest > 0.0


# ------------------------------------------------------------------ warnings


def turning(dt: float, rate: float, n: int = 200, seed: int = 0) -> tuple[Array, Array, Array]:
    """Times, rates and quaternions of a noisy turn about a tilted axis."""
    t = np.arange(n) * dt
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    half = 0.5 * rate * t
    q = np.column_stack([np.cos(half), np.sin(half)[:, None] * axis])
    noise = 1e-2 * rate * np.random.default_rng(seed).standard_normal((n, 3))
    return t, rate * axis + noise, q


@pytest.mark.parametrize("rate", [1e-4, 1e-3, 0.06])
@pytest.mark.parametrize("every", [1, 7])
def test_rates_in_degrees_are_told_by_the_star_fixes(rate: float, every: int) -> None:
    t, w, q = turning(0.1, rate)
    flips = np.where(np.arange(len(t)) % 3, 1.0, -1.0)[:, None]
    star = (t[::every], (q * flips)[::every])
    with pytest.warns(
        CelestcoreWarning, match=r"degrees per second; multiply it by celestcore\.DEG"
    ):
        SensorLog(gyro=(t, w / DEG), star_1=star)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("rate", [0.0, 1e-4, 0.06, 1.0, 6.0, 60.0])
def test_rates_in_radians_do_not_warn(rate: float) -> None:
    t, w, q = turning(0.1, rate)
    SensorLog(gyro=(t, w), star=(t, q))
    SensorLog(gyro=(t, w), star=(t[:1], q[:1]))
    SensorLog(gyro=(t, w + 1e-3), star=(t[::50], q[::50]))


def test_sigmas_in_degrees_warn() -> None:
    with pytest.warns(CelestcoreWarning, match="star.sigma is 5 rad"):
        SensorLog(star=(T, Q, 5.0))
    with pytest.warns(CelestcoreWarning, match="vector_a.sigma"):
        SensorLog(vector_a=(T, B, B, 2.0))


def test_seconds_since_1970_warn() -> None:
    with pytest.warns(CelestcoreWarning, match="1970"):
        SensorLog(gyro=(T + 1.7e9, RATE))


# ------------------------------------------------------------------ settings and speed


def test_settings_fill_what_is_not_given() -> None:
    settings: dict[str, Any] = {
        "log": {"title": "from file", "epoch": "2020-01-01", "source": "me"},
        "frames": {"inertial": "GCRS"},
        "gyro": {"arw": 1e-6},
    }
    log = SensorLog(gyro=(T, RATE), settings=settings, frames={"body": "bus"})
    assert (log.title, log.epoch) == ("from file", "2020-01-01")
    assert log.frames == {"inertial": "GCRS", "body": "bus"}
    assert "body" not in settings["frames"]
    over = SensorLog(gyro=(T, RATE), settings=settings, title="mine", epoch="2026-01-01")
    assert (over.title, over.epoch) == ("mine", "2026-01-01")
    checked = SensorLog(gyro=(T, RATE), settings=Settings.from_dict(settings))
    assert checked.settings["gyro"] == {"arw": 1e-6}


def test_build_table_refuses_unknown_names() -> None:
    with pytest.raises(InputError, match="no table of a log"):
        build_table("horizon", (T, B))


@pytest.mark.bench
def test_a_million_samples_in_15_ms() -> None:
    n = 1_000_000
    t, rate = np.arange(n) * 0.1, np.full((n, 3), 1e-3)
    best = np.inf
    for _ in range(10):
        start = time.perf_counter()
        SensorLog(gyro=(t, rate))
        best = min(best, time.perf_counter() - start)
    assert best < 0.015
