"""Time scales, the Earth's orientation, Sun and Moon against ERFA, astropy and the IERS' files."""

from __future__ import annotations

import sys
import warnings
from collections.abc import Iterator
from pathlib import Path

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames
from celestcore.frames import _iers, _series, _time

erfa = pytest.importorskip("erfa")
iers_data = pytest.importorskip("astropy_iers_data")

EPOCH = "2007-07-01T12:00:00"
SPAN = np.linspace(0.0, 36000.0, 97)


@pytest.fixture
def no_erfa(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "erfa", None)


@pytest.fixture
def no_table(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    monkeypatch.setitem(sys.modules, "astropy_iers_data", None)
    _iers.table.cache_clear()
    yield
    _iers.table.cache_clear()


def both(pair: tuple[float, np.ndarray]) -> np.ndarray:
    return np.stack(np.broadcast_arrays(*pair), axis=-1)


# --- time ----------------------------------------------------------------------------------------


def test_leap_seconds_are_those_of_erfa_and_of_the_iers() -> None:
    leaps = erfa.leap_seconds.get()
    leaps = leaps[leaps["year"] >= 1972]
    days, values = _time.leap_table()
    got = [erfa.jd2cal(_time.JD_MJD, float(d))[:2] for d in days]
    assert [(int(y), int(m)) for y, m in got] == [(r["year"], r["month"]) for r in leaps]
    assert list(values) == list(leaps["tai_utc"])
    rows = Path(iers_data.IERS_LEAP_SECOND_FILE).read_text().splitlines()
    rows = [r.split() for r in rows if r.strip() and not r.startswith("#")]
    assert list(zip(days, values, strict=True)) == [(int(float(r[0])), int(r[-1])) for r in rows]


@pytest.mark.parametrize(
    "text",
    [
        "1972-01-01T00:00:00",
        "2007-07-01T12:00:00",
        "2015-06-30T23:59:60.25",
        "2016-12-31T23:59:60",
        "2017-01-01T00:00:00",
        "2026-03-04T05:06:07.125Z",
    ],
)
def test_utc_to_tt_and_back_as_erfa(text: str) -> None:
    date, clock = text.rstrip("Z").split("T")
    y, m, d = map(int, date.split("-"))
    h, mi, s = clock.split(":")
    utc = erfa.dtf2d("UTC", y, m, d, int(h), int(mi), float(s))
    want = erfa.taitt(*erfa.utctai(*utc))
    start = _time.instant(text)
    got = start.julian()
    assert ((got[0] - want[0]) + (got[1] - want[1])) * 86400.0 == pytest.approx(0.0, abs=2e-11)
    t = np.array([-5e7, -0.5, 0.0, 0.5, 1.0, 2e7])[0 if y > 1973 else 2 :]
    whole, rest = np.divmod(start.seconds - 32.184 + t, 86400.0)
    back = both(erfa.taiutc(got[0] + whole, rest / 86400.0))
    ours = frames.julian_date(text, t, scale="UTC")
    assert np.abs((ours - back).sum(axis=-1)).max() * 86400.0 < 1e-9


def test_the_scales_differ_as_they_should() -> None:
    def tt(text: str) -> float:
        start = _time.instant(text)
        return (start.mjd - 54282) * 86400.0 + start.seconds

    noon = tt("2007-07-01T12:00:00 TT")
    assert noon == 43200.0
    assert tt("2007-07-01T12:00:00 TAI") - noon == pytest.approx(32.184, abs=1e-9)
    assert tt("2007-07-01T12:00:00") - noon == pytest.approx(65.184, abs=1e-9)
    assert tt("2007-07-01T12:00:00 GPS") - noon == pytest.approx(51.184, abs=1e-9)
    assert tt("2007-07-01T14:00:00+02:00") == tt("2007-07-01T12:00:00Z")
    assert tt("2007-06-30T22:30:00-1330") == tt("2007-07-01T12:00:00Z")
    # TCG, TCB and TDB against ERFA's own conversions
    jd, rest = 2454282.5, 0.5
    for scale, chain in {
        "TCG": lambda: erfa.tcgtt(jd, rest),
        "TDB": lambda: erfa.tdbtt(jd, rest, float(erfa.dtdb(jd, rest, rest, 0.0, 0.0, 0.0))),
        "TCB": lambda: erfa.tdbtt(
            *erfa.tcbtdb(jd, rest), float(erfa.dtdb(jd, rest, rest, 0.0, 0.0, 0.0))
        ),
    }.items():
        a, b = chain()
        want = ((a - jd) + b) * 86400.0
        assert tt(f"2007-07-01T12:00:00 {scale}") == pytest.approx(float(want), abs=3e-5), scale


def test_tdb_is_good_to_thirty_microseconds() -> None:
    days = np.random.default_rng(1).uniform(-20 * 365.25, 50 * 365.25, 2000)
    want = erfa.dtdb(2451545.0, days, 0.0, 0.0, 0.0, 0.0)
    assert np.abs(_time.tdb_minus_tt(days / 36525.0) - want).max() < 3e-5


def test_ut1_to_and_fro() -> None:
    jd = frames.julian_date(EPOCH, 0.0, scale="UT1")
    # IERS C04: UT1 - UTC of 2007-07-01 and -02 at 0h
    day = (jd[1] - 0.5) * 86400.0
    rows = Path(iers_data.IERS_B_FILE).read_text().splitlines()
    near = [float(r[50:62]) for r in rows if r.startswith(("2007   7   1", "2007   7   2"))]
    assert day == pytest.approx(0.5 * sum(near), abs=5e-5)
    start = _time.instant("2007-07-01T12:00:00 UT1")
    assert start.seconds == pytest.approx(43200.0 + 65.184 - day, abs=1e-6)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("1971-12-31T23:59:59", "before 1972"),
        ("2007-07-01T23:59:60", "leap second where none"),
        ("2016-12-31T23:59:60 TAI", "only UTC"),
        (None, "is needed"),
        ("yesterday", "ISO time"),
        ("2050-01-01 UT1", "outside the table"),
    ],
)
def test_times_that_cannot_be_are_refused(text: str | None, says: str) -> None:
    with pytest.raises(cc.InputError, match=says) as caught:
        frames.julian_date(text)
    assert caught.value.field == "epoch"


def test_scale_and_times_are_checked() -> None:
    with pytest.raises(cc.InputError, match="from 1972 on"):
        frames.julian_date("1972-01-01", -0.5, scale="UTC")
    with pytest.raises(cc.InputError, match="one of TT"):
        frames.julian_date(EPOCH, scale="UTX")
    with pytest.raises(cc.InputError, match="row 1, value nan"):
        frames.gcrs_to_itrs(EPOCH, [0.0, np.nan])


# --- the Earth's orientation ---------------------------------------------------------------------


def reference(epoch: str, t: np.ndarray) -> np.ndarray:
    """Build the matrix from ERFA's parts, with the pole and UT1 that celestcore interpolates."""
    start = _time.instant(epoch)
    eop, (day, rest) = _iers.orientation(start, t), start.julian(t)
    x, y, _ = erfa.xys06a(day, rest)
    x, y = x + eop.dx, y + eop.dy
    celestial = erfa.c2ixys(x, y, erfa.s06(day, rest, x, y))
    era = erfa.era00(day, rest + eop.ut1_tt / 86400.0)
    return erfa.c2tcio(celestial, era, erfa.pom00(eop.xp, eop.yp, erfa.sp00(day, rest)))


@pytest.mark.parametrize("epoch", ["1975-02-03", EPOCH, "2016-12-31T18:00:00", "2026-10-11"])
@pytest.mark.parametrize("n", [3, 500])
def test_matrix_is_erfas(epoch: str, n: int) -> None:
    t = np.linspace(-7200.0, 36000.0, n)
    got = frames.gcrs_to_itrs(epoch, t)
    assert np.abs(got - reference(epoch, t)).max() < 1e-12
    assert np.array_equal(frames.itrs_to_gcrs(epoch, t), np.swapaxes(got, 1, 2))


def test_matrix_without_measurements_is_c2t06a() -> None:
    start = _time.instant(EPOCH)
    day, rest = start.julian(SPAN)
    with pytest.warns(cc.CelestcoreWarning, match="14 arcsec"):
        got = frames.gcrs_to_itrs(EPOCH, SPAN, orientation="zero")
    want = erfa.c2t06a(day, rest, day, rest - 65.184 / 86400.0, 0.0, 0.0)
    assert np.abs(got - want).max() < 1e-12


def test_matrix_agrees_with_astropy() -> None:
    pytest.importorskip("astropy")
    from astropy.coordinates import GCRS, ITRS, CartesianRepresentation
    from astropy.time import Time
    from astropy.utils import iers

    with warnings.catch_warnings(), iers.conf.set_temp("auto_download", False):
        warnings.simplefilter("ignore")
        iers.earth_orientation_table.set(iers.IERS_B.open(iers_data.IERS_B_FILE))
        when = Time(EPOCH, scale="utc")
        axes = GCRS(CartesianRepresentation(np.eye(3)), obstime=when)
        want = axes.transform_to(ITRS(obstime=when)).cartesian.xyz.value
    # astropy interpolates UT1 linearly: some microseconds of it, 15 times 1e-6 arcsec each
    assert np.abs(frames.gcrs_to_itrs(EPOCH) - want).max() < 3e-9


def test_tables_are_interpolated_through_the_iers_values() -> None:
    rows = Path(iers_data.IERS_B_FILE).read_text().splitlines()
    row = next(r for r in rows if r.startswith("2016  12  31"))
    eop = _iers.orientation(_time.instant("2016-12-31T00:00:00"), 0.0)
    arcsec = cc.ARCSEC
    assert float(eop.xp) == pytest.approx(float(row[26:38]) * arcsec, rel=1e-9)
    assert float(eop.yp) == pytest.approx(float(row[38:50]) * arcsec, rel=1e-9)
    assert float(eop.ut1_tt) == pytest.approx(float(row[50:62]) - 36.0 - 32.184, abs=1e-9)
    assert float(eop.dx) == pytest.approx(float(row[62:74]) * arcsec, rel=1e-6)
    assert not eop.predicted
    # a leap second is no jump of UT1 - TT
    near = _iers.orientation(_time.instant("2016-12-31T23:59:00"), np.arange(0.0, 120.0)).ut1_tt
    assert np.abs(np.diff(near)).max() < 1e-7


def test_bulletin_a_carries_on_where_the_final_series_ends() -> None:
    have = _iers.table()
    assert have is not None
    assert np.array_equal(np.diff(have.mjd), np.ones(len(have.mjd) - 1))
    seam = int(np.searchsorted(have.mjd, have.measured_until))
    steps = np.abs(np.diff(have.values[seam - 5 : seam + 6], axis=0)).max(axis=0)
    assert (steps < [2e-8, 2e-8, 3e-3, 2e-9, 2e-9]).all()
    assert have.mjd[-1] > have.measured_until


@pytest.mark.parametrize("epoch", ["2090-01-01", "1971-01-01 TAI"])
def test_outside_the_table_is_an_error_that_says_the_way_out(epoch: str) -> None:
    with pytest.raises(cc.InputError, match=r"1972-01-01 to 20.*orientation='zero'"):
        frames.environment(epoch, 600.0)
    with pytest.warns(cc.CelestcoreWarning, match="taken as zero"):
        assert len(frames.environment(epoch, 600.0, orientation="zero")) == 9


def test_velocities_are_derivatives_of_positions() -> None:
    rng = np.random.default_rng(3)
    v = rng.standard_normal(3) * 7e3
    r0 = rng.standard_normal(3) * 7e6 / np.sqrt(3.0)
    t = np.array([-0.5, 0.0, 0.5])
    r_e, v_e = frames.to_itrs(EPOCH, t, r0 + v * t[:, None], np.tile(v, (3, 1)))
    assert v_e is not None
    assert np.abs((r_e[2] - r_e[0]) - v_e[1]).max() < 1e-4
    r, back = frames.to_gcrs(EPOCH, t, r_e, v_e)
    assert back is not None
    assert np.abs(r - (r0 + v * t[:, None])).max() < 1e-8
    assert np.abs(back - v).max() < 1e-11
    assert frames.to_itrs(EPOCH, t, r)[1] is None
    with pytest.raises(cc.InputError, match=r"v: has shape \(2, 3\), needed is \(3, 3\)"):
        frames.to_itrs(EPOCH, t, r, np.zeros((2, 3)))


def test_shapes_and_emptiness() -> None:
    assert frames.gcrs_to_itrs(EPOCH).shape == (3, 3)
    assert frames.gcrs_to_itrs(EPOCH, np.zeros((2, 5))).shape == (2, 5, 3, 3)
    assert frames.gcrs_to_itrs(EPOCH, []).shape == (0, 3, 3)
    assert frames.sun(EPOCH, np.zeros((2, 5))).shape == (2, 5, 3)
    assert frames.moon(EPOCH, []).shape == (0, 3)


# --- Sun, Moon and the tables --------------------------------------------------------------------


def test_sun_and_moon_are_erfas() -> None:
    day, rest = _time.instant(EPOCH).julian(SPAN)
    heliocentric, barycentric = erfa.epv00(day, rest)
    assert np.allclose(frames.sun(EPOCH, SPAN), -heliocentric["p"] * erfa.DAU, rtol=0, atol=1e-3)
    moon = erfa.moon98(day, rest)["p"] * erfa.DAU
    assert np.allclose(frames.moon(EPOCH, SPAN), moon, rtol=0, atol=1e-6)
    speed = barycentric["v"] * erfa.DAU / 86400.0
    assert np.allclose(frames.earth_velocity(EPOCH, SPAN), speed, rtol=0, atol=1e-9)


def test_tables_are_uniform_complete_and_right() -> None:
    tables = frames.environment(EPOCH, 36000.0)
    earth_t, body_t = tables["earth_t"], tables["body_t"]
    assert np.array_equal(np.diff(earth_t), np.full(len(earth_t) - 1, 3600.0))
    assert np.array_equal(np.diff(body_t), np.full(len(body_t) - 1, 7200.0))
    for t in (earth_t, body_t):
        assert t[0] <= -6 * 3600.0
        assert t[-1] >= 36000.0 + 6 * 3600.0
    for value in tables.values():
        assert value.dtype == np.float64
        assert value.flags.c_contiguous
    start = _time.instant(EPOCH)
    eop, rest = _iers.orientation(start, earth_t), start.julian(earth_t)[1]
    celestial = erfa.c2ixys(*tables["cip"].T)
    ut1 = tables["ut1"][1] + (earth_t + tables["dut1"]) / 86400.0
    polar = erfa.pom00(*tables["pole"].T, tables["sp"])
    got = erfa.c2tcio(celestial, erfa.era00(tables["ut1"][0], ut1), polar)
    assert np.abs(got - reference(EPOCH, earth_t)).max() < 1e-12
    assert np.allclose(ut1 - rest, eop.ut1_tt / 86400.0, rtol=0, atol=1e-15)
    assert np.array_equal(tables["sun"], frames.sun(EPOCH, body_t))
    assert np.array_equal(tables["moon"], frames.moon(EPOCH, body_t))


@pytest.mark.parametrize("duration", [0.0, 1.0, -5e4, 86400.0])
def test_tables_have_six_hours_of_margin(duration: float) -> None:
    tables = frames.environment(EPOCH, duration)
    for name in ("earth_t", "body_t"):
        assert tables[name][0] <= min(duration, 0.0) - 21600.0
        assert tables[name][-1] >= max(duration, 0.0) + 21600.0
        assert 0.0 in tables[name]


def test_tables_take_a_first_and_a_last_time() -> None:
    tables = frames.environment(EPOCH, (-5e4, 7e4))
    assert tables["earth_t"][0] <= -5e4 - 21600.0
    assert tables["earth_t"][-1] >= 7e4 + 21600.0


def test_tables_are_close_enough_together() -> None:
    """Interpolate by Lagrange's polynomial through the nearest points, as a propagator does."""
    points = 8
    tables, t = frames.environment(EPOCH, 36000.0), np.linspace(0.0, 36000.0, 301)
    start = _time.instant(EPOCH)
    (day, rest), eop = start.julian(t), _iers.orientation(start, t)
    x, y, _ = erfa.xys06a(day, rest)
    x, y = x + eop.dx, y + eop.dy
    cip = np.stack([x, y, erfa.s06(day, rest, x, y)], axis=-1)

    def between(nodes: np.ndarray, values: np.ndarray) -> np.ndarray:
        u = (t - nodes[0]) / (nodes[1] - nodes[0])
        first = np.clip(np.floor(u).astype(int) - points // 2 + 1, 0, len(nodes) - points)
        out = np.zeros((len(t), values.shape[1]))
        for j in range(points):
            others = [k for k in range(points) if k != j]
            weight = np.prod([(u - first - k) / (j - k) for k in others], axis=0)
            out += weight[:, None] * values[first + j]
        return out

    assert np.abs(between(tables["earth_t"], tables["cip"]) - cip).max() < 1e-13
    sun, moon = (between(tables["body_t"], tables[name]) for name in ("sun", "moon"))
    assert np.abs(sun - frames.sun(EPOCH, t)).max() < 0.01
    assert np.abs(moon - frames.moon(EPOCH, t)).max() < 0.001


def test_zero_orientation_takes_the_leap_seconds_of_its_start() -> None:
    for text, leap in {
        "2016-12-31T23:59:59": 36,
        "2016-12-31T23:59:60.5": 36,
        "2017-01-01T00:00:00": 37,
        "2017-01-01T00:01:00": 37,
    }.items():
        got = _iers.orientation(_time.instant(text), 0.0, "zero").ut1_tt
        assert float(got) == -(leap + 32.184), text


def test_a_run_across_a_leap_second_turns_on_evenly() -> None:
    tables = frames.environment("2016-12-31T18:00:00", 36000.0)
    assert np.abs(np.diff(tables["dut1"])).max() < 1e-4
    with pytest.warns(cc.CelestcoreWarning):
        zero = frames.environment("2016-12-31T18:00:00", 36000.0, orientation="zero")
    assert not zero["dut1"].any()
    assert abs((zero["ut1"][1] - tables["ut1"][1]) * 86400.0) < 0.9


def test_duration_and_choices_are_checked() -> None:
    with pytest.raises(cc.InputError, match="duration"):
        frames.environment(EPOCH, np.inf)
    with pytest.raises(cc.InputError, match="duration"):
        frames.environment(EPOCH, [0.0, np.nan])
    with pytest.raises(cc.InputError, match="first and a last"):
        frames.environment(EPOCH, [0.0, 1.0, 2.0])
    with pytest.raises(cc.InputError, match="century"):
        frames.environment(EPOCH, 1e11)
    with pytest.raises(cc.InputError, match="orientation"):
        frames.environment(EPOCH, 1.0, orientation="none")
    with pytest.raises(cc.InputError, match="method"):
        frames.sun(EPOCH, method="jpl")


# --- without the extra ---------------------------------------------------------------------------


def test_short_series_are_as_good_as_they_say() -> None:
    t = np.random.default_rng(5).uniform(-0.1, 0.4, 4000)
    days = t * 36525.0
    x, y, s = erfa.xys06a(2451545.0, days)
    pole = _series.pole(t)
    assert np.hypot(pole[:, 0] - x, pole[:, 1] - y).max() < 0.04 * cc.ARCSEC
    assert np.abs(pole[:, 2] - s).max() < 0.004 * cc.ARCSEC
    heliocentric, _ = erfa.epv00(2451545.0, days)
    for got, want, angle, distance in (
        (_series.sun(t), -heliocentric["p"] * erfa.DAU, 40.0, 1e-4),
        (_series.moon(t), erfa.moon98(2451545.0, days)["p"] * erfa.DAU, 300.0, 2e-3),
    ):
        a, b = (np.linalg.norm(z, axis=1, keepdims=True) for z in (got, want))
        assert np.linalg.norm(got / a - want / b, axis=1).max() < angle * cc.ARCSEC
        assert np.abs(a / b - 1.0).max() < distance


def test_without_pyerfa_it_works_and_says_what_it_costs(no_erfa: None) -> None:
    with pytest.warns(cc.CelestcoreWarning, match=r"0\.04 arcsec.*celestcore\[orbit\]") as caught:
        got = frames.environment(EPOCH, 36000.0)
    assert [Path(w.filename).name for w in caught] == [Path(__file__).name]
    asked = frames.environment(EPOCH, 36000.0, method="builtin")
    assert all(np.array_equal(got[k], asked[k]) for k in asked)
    with pytest.raises(cc.MissingDependencyError, match=r"celestcore\[orbit\]"):
        frames.sun(EPOCH, method="erfa")


def test_built_in_rotation_is_near() -> None:
    near = frames.gcrs_to_itrs(EPOCH, SPAN, method="builtin")
    assert np.abs(near - frames.gcrs_to_itrs(EPOCH, SPAN)).max() < 0.06 * cc.ARCSEC
    speed = frames.earth_velocity(EPOCH, SPAN, method="builtin")
    assert np.abs(speed - frames.earth_velocity(EPOCH, SPAN)).max() < 30.0
    away = frames.earth_position(EPOCH, SPAN, method="builtin")
    assert np.abs(away - frames.earth_position(EPOCH, SPAN)).max() < 2e9


def test_without_the_tables_it_works_and_says_what_it_costs(no_table: None) -> None:
    with pytest.warns(cc.CelestcoreWarning, match="460 m at a radius of 7000 km"):
        got = frames.environment(EPOCH, 36000.0)
    assert not got["pole"].any()
    with pytest.raises(cc.InputError, match="needs the Earth's orientation"):
        frames.julian_date("2007-07-01 UT1")


def test_the_cost_that_the_warning_names_is_the_worst_there_was() -> None:
    have = _iers.table()
    assert have is not None
    dut1 = have.values[:, 2] + _time.leap_seconds(have.mjd) + 32.184
    turn = 15.041 * np.abs(dut1).max()
    pole = np.hypot(have.values[:, 0], have.values[:, 1]).max() / cc.ARCSEC
    assert 11.0 < np.hypot(turn, pole) < 14.0
