"""Times in order, whatever way they come in: late rows, repeats, jumps, scales, counters."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from celestcore.errors import InputError
from celestcore.formats import SensorReport, Stamps
from celestcore.formats._stamps import Clock, epoch_of
from celestcore.formats._timeline import Timeline, join
from hypothesis import given, settings
from hypothesis import strategies as st

Array = np.ndarray[Any, np.dtype[np.float64]]
EPOCH = "2026-01-01T00:00:00"


def run(
    t: Any,
    *,
    reorder: float | None = 0.0,
    jump: float | None = None,
    cuts: Any = (),
    values: Any = None,
) -> tuple[Array, Array, SensorReport]:
    """Feed rows in pieces; return the times and values that come out, and the report."""
    t = np.asarray(t, dtype=float)
    x = np.arange(len(t), dtype=float) if values is None else np.asarray(values, dtype=float)
    report = SensorReport()
    line = Timeline("gyro", Clock(Stamps(), None, "gyro.t"), reorder, jump, report)
    out = []
    for piece in np.split(np.arange(len(t)), sorted(cuts)):
        out += line.feed({"t": t[piece], "wx": x[piece]})
    out += line.finish()
    whole = join(out) if out else {"t": np.empty(0), "wx": np.empty(0)}
    return whole["t"], whole["wx"], report


cut_points = st.lists(st.integers(0, 60), max_size=6)


@given(st.integers(0, 2**32 - 1), st.floats(0.0, 5.0), cut_points)
def test_shuffled_within_the_window_gives_the_same_log(
    seed: int, window: float, cuts: list[int]
) -> None:
    rng = np.random.default_rng(seed)
    t = np.cumsum(rng.uniform(0.01, 1.0, 60))
    order = np.argsort(t + rng.uniform(0.0, window, 60), kind="stable")
    got_t, got_x, report = run(t[order], reorder=window, cuts=cuts, values=order)
    assert np.array_equal(got_t, t)
    assert np.array_equal(got_x, np.arange(60))
    assert report.late == report.repeated == 0
    before = np.maximum.accumulate(t[order])
    assert report.reordered == int(np.sum(t[order] < before))


@given(
    st.lists(st.integers(0, 40), min_size=1, max_size=60), st.integers(0, 6), cut_points, cut_points
)
def test_what_comes_out_does_not_depend_on_the_chunks(
    t: list[int], window: int, cuts: list[int], others: list[int]
) -> None:
    a = run(t, reorder=window, cuts=cuts)
    b = run(t, reorder=window, cuts=others)
    assert np.array_equal(a[0], b[0])
    assert np.array_equal(a[1], b[1])
    assert a[2] == b[2]
    assert (np.diff(a[0]) > 0).all()
    assert a[2].rows == len(t)
    assert len(a[0]) == len(t) - a[2].late - a[2].repeated


@given(st.lists(st.integers(0, 40), min_size=1, max_size=40), st.integers(0, 6))
def test_late_rows_are_those_too_far_behind_the_newest(t: list[int], window: int) -> None:
    kept: dict[int, int] = {}
    late = repeated = 0
    newest = -1
    for row, value in enumerate(t):
        if newest - value > window:
            late += 1
        elif value in kept:
            repeated += 1
        else:
            kept[value] = row
        newest = max(newest, value)
    got_t, got_x, report = run(t, reorder=window)
    assert got_t.tolist() == sorted(kept)
    assert got_x.tolist() == [kept[k] for k in sorted(kept)]
    assert (report.late, report.repeated) == (late, repeated)


def test_repeats_that_disagree_are_told_apart() -> None:
    _, x, report = run([0, 1, 1, 1, 2], values=[5, 6, 6, 7, 8])
    assert x.tolist() == [5, 6, 8]
    assert (report.repeated, report.conflicting) == (2, 1)
    assert report.troubles == {"repeated": 2, "conflicting": 1}
    assert run([0, 1, 1], values=[0, np.nan, np.nan])[2].conflicting == 0


def test_rows_without_a_time_are_counted() -> None:
    t, _, report = run([0, np.nan, 1, np.inf, 2])
    assert t.tolist() == [0, 1, 2]
    assert report.undated == 2


@given(cut_points)
def test_a_stray_stamp_is_left_out_and_a_jump_reported(cuts: list[int]) -> None:
    t = np.arange(60.0)
    t[0] = 1e9
    t[20] = 1e6
    t[31:33] = -4e5
    t[40:] += 3600.0
    got, x, report = run(t, reorder=2.0, jump=100.0, cuts=cuts)
    good = [k for k in range(60) if k not in (0, 20, 31, 32)]
    assert x.tolist() == good
    assert np.array_equal(got, t[good])
    assert report.stray == 4
    assert [(j.row, j.before, j.after) for j in report.jumps] == [(40, 39.0, 3640.0)]


def test_a_clock_set_back_is_a_jump_and_its_rows_are_late() -> None:
    t = np.concatenate([np.arange(20.0), np.arange(5.0, 25.0)])
    got, _, report = run(t, reorder=1.0, jump=10.0)
    assert report.jumped == 1
    assert report.jumps[0].row == 20
    assert np.array_equal(got, np.arange(25.0))
    assert report.late == 13


@pytest.mark.parametrize("cuts", [[], [2], [3], [4]])
@pytest.mark.parametrize(
    ("t", "row", "words"),
    [
        ([0, 1, 2, 2], 3, r"repeats row 2 \(2.0\)"),
        ([0, 1, 2, 1], 3, r"goes back, it is before row 2"),
        ([0, 1, 2, np.nan], 3, "finite"),
    ],
)
def test_without_a_window_disorder_is_an_error_that_names_the_row(
    t: list[float], row: int, words: str, cuts: list[int]
) -> None:
    with pytest.raises(InputError, match=words) as caught:
        run(t, reorder=None, cuts=cuts)
    assert (caught.value.field, caught.value.row) == ("gyro.t", row)


# ------------------------------------------------------------------ scales


def seconds(values: Any, epoch: str | None = EPOCH, **stamps: Any) -> list[float]:
    t: list[float] = Clock(Stamps(**stamps), epoch).seconds(np.asarray(values)).tolist()
    return t


def test_scales_agree_on_one_instant() -> None:
    # 2026: TAI - UTC = 37 s, GPS - UTC = 18 s, TT - TAI = 32.184 s
    assert seconds(["2026-01-01T00:00:05"]) == [5.0]
    assert seconds(["2026-01-01T00:00:42"], scale="TAI") == [5.0]
    assert seconds(["2026-01-01T00:00:23"], scale="GPS") == [5.0]
    assert seconds(["2026-01-01T00:01:14.184"], scale="TT") == pytest.approx([5.0], abs=1e-9)
    assert seconds([1767225605], since="1970-01-01") == [5.0]
    assert seconds([1767225605.0], since="1970-01-01") == [5.0]
    assert seconds([1451260823], scale="GPS", since="1980-01-06") == [5.0]
    assert seconds(["2026-01-01T00:00:05"], epoch="2026-01-01T00:00:37 TAI") == [5.0]
    assert seconds(["2026-01-01T02:00:05+02:00", "2026-01-01T00:00:42 TAI"]) == [5.0, 5.0]


def test_utc_has_its_leap_second_and_unix_time_has_not() -> None:
    texts = ["2016-12-31T23:59:59", "2016-12-31T23:59:60.5Z", "2017-01-01T00:00:00"]
    assert seconds(texts, "2016-12-31T23:59:59") == [0.0, 1.5, 2.0]
    unix = [1483228799, 1483228800]
    assert seconds(unix, "2016-12-31T23:59:59", since="1970-01-01") == [0.0, 2.0]
    gps = [1167264016, 1167264018]
    assert seconds(gps, "2016-12-31T23:59:59", since="1980-01-06", scale="GPS") == [0.0, 2.0]
    with pytest.raises(InputError, match="leap second"):
        seconds(["2026-12-31T23:59:60"], EPOCH)


@pytest.mark.parametrize("kind", ["M8[ns]", "M8[us]", "M8[s]"])
def test_datetimes_and_gaps(kind: str) -> None:
    values = np.array(["2026-01-01T00:00:05", "NaT"], dtype=kind)
    t = seconds(values)
    assert t[0] == 5.0
    assert np.isnan(t[1])


def test_nanoseconds_since_1970_keep_their_digits() -> None:
    base = 1767225600_000_000_000
    counts = base + np.arange(5) * 1_000_001
    t = seconds(counts, since="1970-01-01", unit=1e-9)
    assert t == pytest.approx([0.0, 1.000001e-3, 2.000002e-3, 3.000003e-3, 4.000004e-3], abs=1e-15)


def test_a_text_that_is_no_time_is_named() -> None:
    with pytest.raises(InputError) as caught:
        seconds(["2026-01-01T00:00:00", "soon"])
    assert (caught.value.row, caught.value.value) == (1, "soon")
    with pytest.raises(InputError, match="epoch"):
        seconds(["2026-01-01T00:00:00"], None)


@pytest.mark.parametrize(
    "wrong",
    [{"scale": "UT1"}, {"unit": 0.0}, {"unit": np.nan}, {"bits": 2}, {"since": "soon"}],
)
def test_wrong_stamps(wrong: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        Stamps(**wrong)


def test_the_epoch_of_a_log_is_its_first_whole_second() -> None:
    assert epoch_of(np.array(["2026-01-01T00:00:05.75"]), Stamps()) == "2026-01-01T00:00:05"
    assert epoch_of([1451260823.5], Stamps(scale="GPS", since="1980-01-06")) == (
        "2026-01-01T00:00:05"
    )


@settings(deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.lists(st.integers(-3, 2**31 - 1), min_size=1, max_size=30),
    st.lists(st.integers(0, 30), max_size=4),
)
def test_a_counter_that_wraps(first: int, steps: list[int], cuts: list[int]) -> None:
    true = first + np.concatenate([[0], np.cumsum(np.asarray(steps, dtype=np.int64))])
    raw = (true % 2**32).astype(np.uint32)
    clock = Clock(Stamps(unit=1e-3, bits=32), None)
    t = np.concatenate([clock.seconds(p) for p in np.split(raw, sorted(cuts))])
    assert np.array_equal(t, true * 1e-3)
    forward = np.diff(true // 2**32).clip(min=0).sum() if (np.diff(true) >= 0).all() else None
    if forward is not None:
        assert clock.wraps == forward
