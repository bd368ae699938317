"""Panels: what is left of long series, where lines break, and what the page's script is given."""

from __future__ import annotations

import base64
import hashlib
from importlib.resources import files
from typing import Any

import numpy as np
import pytest
from celestcore._attitude_panels import euler_sigma
from celestcore._curves import euler_321, time_axis
from celestcore._panels import (
    DOTS,
    Panel,
    Series,
    Times,
    extreme_rows,
    kept_rows,
    longest,
    page_data,
)
from celestcore.quaternion import exp, multiply
from celestcore.solution import Array


def times(t: Array, gaps: Any = (), epoch: str | None = None) -> Times:
    many = np.asarray(gaps, dtype=float).reshape(-1, 2)
    return Times(time_axis(t, epoch), float(t[0]), float(t[-1]), epoch, many)


def column(text: str, kind: str = "<f4") -> Array:
    return np.frombuffer(base64.b64decode(text), dtype=kind).astype(float)


def drawn(panel: Panel, where: Times) -> tuple[Array, list[dict[str, Any]]]:
    """Return the places and the series of a single panel, unpacked."""
    (out,) = page_data([panel], where)["panels"]
    series = [
        {k: column(v) if k in ("y", "half", "exact") and v else v for k, v in s.items()}
        for s in out["series"]
    ]
    return column(out["x"], "<f8"), series


@pytest.mark.parametrize("n", [0, 1, 2, 199, 200, 201, 1000, 99_999])
def test_extremes_of_every_bucket_stay(n: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    rows = extreme_rows(y, 100)
    assert len(rows) <= 201
    assert np.all(np.diff(rows) > 0)
    if n:
        assert {int(y.argmin()), int(y.argmax())} <= set(rows.tolist())


def test_nan_neither_hides_extremes_nor_gets_lost() -> None:
    y = np.random.default_rng(1).standard_normal(10_000)
    y[5000:5100] = np.nan
    y[5150] = 9.0
    rows = extreme_rows(y, 50)
    assert 5150 in rows
    assert np.isnan(y[rows]).any()


def test_a_spike_in_a_day_is_drawn_and_the_payload_is_short() -> None:
    t = 0.1 * np.arange(864_000)
    y = np.sin(t / 5000.0)
    y[400_001] = 7.0
    x, (series,) = drawn(Panel("a", "m", t, (Series("y", y, half=0.1 + 0.0 * y),)), times(t))
    assert len(x) < 2000
    k = int(series["y"].argmax())
    assert series["y"][k] == 7.0
    assert x[k] * 3600.0 == pytest.approx(t[400_001])
    np.testing.assert_allclose(series["half"], 0.1, rtol=1e-6)


def test_lines_break_in_gaps_and_dots_do_not() -> None:
    t = np.concatenate([np.arange(10.0), 50.0 + np.arange(10.0)])
    y = np.ones(20)
    panel = Panel("a", "", t, (Series("line", y), Series("dots", y, kind="dots")))
    x, (line, dots) = drawn(panel, times(t, [(9.0, 50.0)]))
    assert len(x) == 21
    assert np.flatnonzero(np.isnan(line["y"])).tolist() == [10]
    assert x[10] == 29.5
    assert not np.isnan(dots["y"]).any()


def test_wrapped_lines_break_where_they_jump_and_only_those() -> None:
    t = np.arange(5.0)
    turning = np.array([150.0, 170.0, 190.0, 210.0, 230.0])
    still = np.full(5, 30.0)
    panel = Panel("a", "deg", t, (Series("yaw", turning), Series("roll", still)), period=360.0)
    x, (yaw, roll) = drawn(panel, times(t))
    np.testing.assert_array_equal(yaw["y"], [150.0, 170.0, np.nan, -170.0, -150.0, -130.0])
    np.testing.assert_array_equal(roll["y"], 30.0)
    np.testing.assert_array_equal(x, [0.0, 1.0, 1.5, 2.0, 3.0, 4.0])


def test_clouds_keep_some_dots_and_their_extremes() -> None:
    t = np.arange(500_000.0)
    y = np.random.default_rng(3).standard_normal(500_000)
    rows = kept_rows(Panel("a", "", t, (Series("y", y, kind="dots"),)))
    assert len(rows) < 2 * DOTS
    assert {int(y.argmin()), int(y.argmax())} <= set(rows.tolist())


def test_empty_panels_and_single_rows_are_drawn() -> None:
    none = np.zeros(0)
    where = times(np.arange(2.0), [(0.2, 0.4)])
    for t in (none, np.zeros(1)):
        x, (series,) = drawn(Panel("a", "", t, (Series("y", t),), period=360.0), where)
        assert len(x) == len(series["y"]) == len(t)


def test_the_clock_counts_from_a_utc_epoch_only() -> None:
    t = np.arange(100.0)
    assert page_data([], times(t, epoch="1970-01-02T00:00:01"))["epoch"] == 86_401_000.0
    assert page_data([], times(t, epoch="2026-01-01T01:00:00+01:00"))["epoch"] == 1767225600e3
    assert page_data([], times(t, epoch="2026-01-01T00:00:00 TAI"))["epoch"] is None
    assert page_data([], times(t))["epoch"] is None


def test_the_longest_gaps_are_kept_in_order() -> None:
    begin = 10.0 * np.arange(1000.0)
    gaps = np.column_stack([begin, begin + 1.0 + (np.arange(1000) % 7 == 0)])
    kept = longest(gaps)
    assert len(kept) == 300
    assert np.all(np.diff(kept[:, 0]) > 0)
    assert np.count_nonzero(kept[:, 1] - kept[:, 0] > 1.5) == 143


def test_euler_sigmas_are_those_of_small_turns() -> None:
    rng = np.random.default_rng(5)
    q = exp(rng.standard_normal((20, 3)))
    sigma = np.array([1e-6, 2e-6, 5e-6])
    turns = sigma * rng.standard_normal((4000, 1, 3))
    scatter = np.asarray(euler_321(np.asarray(multiply(q, exp(turns)))) - euler_321(q)).std(axis=0)
    expected = euler_sigma(euler_321(q), np.broadcast_to(sigma, (20, 3)))
    np.testing.assert_allclose(scatter, expected, rtol=0.06)


def test_the_vendored_library_is_what_the_note_says() -> None:
    web = files("celestcore") / "web"
    note = web.joinpath("README.md").read_text(encoding="utf-8")
    for name in ("uPlot.iife.min.js", "uPlot.min.css"):
        data = web.joinpath(name).read_bytes()
        assert hashlib.sha256(data).hexdigest() in note
    assert "MIT License" in web.joinpath("uPlot.LICENSE").read_text(encoding="utf-8")
