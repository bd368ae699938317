"""CCSDS OEM and AEM: round trips, texts checked by hand, other people's files, and faults."""

from __future__ import annotations

import re
import sys
import types
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, quaternion
from celestcore.ccsds import read_aem, read_oem, write_aem, write_oem
from celestcore.ccsds._time import elapsed, utc_strings
from scipy.spatial.transform import Rotation

pytest.importorskip("ccsds_ndm")

EPOCH = "2026-01-01T00:00:00"
NAMES: dict[str, Any] = {"object_name": "SAT 1", "object_id": "2026-001A"}
SUFFIXES = pytest.mark.parametrize("suffix", [".kvn", ".xml"])


def orbit(n: int = 20) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    t = np.arange(n) * 60.1
    elements = cc.elements.Elements(6.884e6, 0.0012, 1.7, 1.75, 1.57, 0.52 + 1.1e-3 * t)
    return t, *cc.elements.to_state(elements)


def lines(path: Path) -> list[str]:
    return path.read_text().splitlines()


# --- times ------------------------------------------------------------------------


def test_utc_strings_count_the_leap_second() -> None:
    made = utc_strings("2016-12-31T23:59:58 ", [0.0, 1.0, 2.0, 2.75, 3.0, 86403.0])
    assert [m[8:-1] for m in made] == [
        "31T23:59:58.00",
        "31T23:59:59.00",
        "31T23:59:60.00",
        "31T23:59:60.75",
        "01T00:00:00.00",
        "02T00:00:00.00",
    ]
    assert elapsed(made, "UTC", "x")[1].tolist() == [0.0, 1.0, 2.0, 2.75, 3.0, 86403.0]


@pytest.mark.parametrize("epoch", [EPOCH, f"{EPOCH} TAI", f"{EPOCH}.123456789 GPS", f"{EPOCH} TT"])
def test_times_come_back_to_a_nanosecond(epoch: str) -> None:
    t = np.cumsum(np.random.default_rng(1).uniform(1e-3, 5e3, 2000)) - 4e6
    texts = utc_strings(epoch, t)
    first, back = elapsed(texts, "UTC", "x")
    assert np.abs(back - (t - t[0])).max() < 2e-9
    apart = frames.julian_date(first) - frames.julian_date(epoch, t[0])
    assert abs(apart.sum()) * 86400.0 < 2e-5


def test_times_agree_with_astropy() -> None:
    astropy = pytest.importorskip("astropy.time")
    t = np.random.default_rng(2).uniform(0, 3e8, 300)
    t.sort()
    start = astropy.Time("2010-03-01T00:00:00", scale="utc")
    known = (start.tai + astropy.TimeDelta(t, format="sec", scale="tai")).utc
    known.precision = 9
    _, expected = elapsed(known.isot, "UTC", "x")
    _, made = elapsed(utc_strings("2010-03-01T00:00:00", t), "UTC", "x")
    assert np.abs(made - expected).max() < 1e-6
    assert np.abs(made - (t - t[0])).max() < 1e-6


def test_no_more_digits_than_needed_and_no_60_by_rounding() -> None:
    assert utc_strings(EPOCH, [0.1 + 0.2])[0].endswith("00.300")
    assert utc_strings(EPOCH, [59.9999999999])[0] == "2026-01-01T00:01:00.000"
    assert utc_strings(EPOCH, [0.5, 1.000001])[0].endswith("00.500000")
    assert utc_strings(EPOCH, [-1e-9])[0] == "2025-12-31T23:59:59.999999999"
    with pytest.raises(cc.InputError, match=r"t, row 1.*nanosecond"):
        utc_strings(EPOCH, [0.0, 1e-10])
    with pytest.raises(cc.InputError, match=r"t, row 1.*goes back"):
        utc_strings(EPOCH, [1.0, 0.0])


@pytest.mark.parametrize(
    "text",
    ["2026-13-01T00:00:00", "2026-01-01", "2026-366T00:00:00", "2026-01-01T24:00:00",
     "2026-01-01T00:00:60", "2025-06-30T23:59:60", "x"],
)  # fmt: skip
def test_times_that_are_none_are_named(text: str) -> None:
    with pytest.raises(cc.InputError, match=r"oem.epoch, row 1, value .* is no UTC time"):
        elapsed([EPOCH, text], "UTC", "oem.epoch")
    with pytest.raises(cc.InputError, match="one of UTC, TAI, TT, GPS"):
        elapsed([EPOCH], "MET", "oem.epoch")


# --- orbit ------------------------------------------------------------------------


@SUFFIXES
def test_an_orbit_comes_back(tmp_path: Path, suffix: str) -> None:
    t, r, v = orbit()
    mix = np.random.default_rng(3).standard_normal((len(t), 6, 6))
    c = mix @ np.swapaxes(mix, 1, 2)
    path = tmp_path / f"orbit{suffix}"
    write_oem(path, EPOCH, t + 5.0, r, v, covariance=c, frame="ITRF", originator="ME", **NAMES)
    back = read_oem(path)
    assert back.epoch == "2026-01-01T00:00:05.000"
    assert np.abs(back.t - t).max() < 1e-9
    assert np.abs(back.r - r).max() < 2e-9
    assert np.abs(back.v - v).max() < 2e-12
    assert back.covariance is not None
    assert np.allclose(back.covariance, c, rtol=1e-14)
    assert back.covariance_t is not None
    assert np.array_equal(back.covariance_t, back.t)
    assert (back.frame, back.covariance_frame, back.center) == ("ITRF", "ITRF", "EARTH")
    assert (back.object_name, back.object_id, back.originator) == ("SAT 1", "2026-001A", "ME")
    assert list(tmp_path.iterdir()) == [path]


def test_the_text_of_an_orbit_is_as_the_standard_wants_it(tmp_path: Path) -> None:
    path = tmp_path / "orbit.oem"
    c = np.diag([1.0, 4.0, 9.0, 1e-6, 1e-6, 1e-6])
    c[1, 0] = c[0, 1] = 0.5
    c[3, 2] = c[2, 3] = 1e-3
    write_oem(
        path, "2026-01-01T00:00:37 TAI", [0.5], [[7e6, -1.5, 0]], [[1.5, 7.5e3, -0.25]],
        covariance=[c], creation_date="2026-02-03T04:05:06", **NAMES,
    )  # fmt: skip
    text = [re.sub(r" +", " ", line) for line in lines(path) if line]
    assert text[:12] == [
        "CCSDS_OEM_VERS = 3.0",
        "CREATION_DATE = 2026-02-03T04:05:06",
        "ORIGINATOR = celestcore",
        "META_START",
        "OBJECT_NAME = SAT 1",
        "OBJECT_ID = 2026-001A",
        "CENTER_NAME = EARTH",
        "REF_FRAME = GCRF",
        "TIME_SYSTEM = UTC",
        "START_TIME = 2026-01-01T00:00:00.500",
        "STOP_TIME = 2026-01-01T00:00:00.500",
        "META_STOP",
    ]
    when, *state = text[12].split()
    assert when == "2026-01-01T00:00:00.500"
    assert [float(x) for x in state] == [7000, -0.0015, 0, 0.0015, 7.5, -0.00025]
    assert text[13:15] == ["COVARIANCE_START", "EPOCH = 2026-01-01T00:00:00.500"]
    assert [[float(x) for x in line.split()] for line in text[15:21]] == [
        [1e-6],
        [5e-7, 4e-6],
        [0, 0, 9e-6],
        [0, 0, 1e-9, 1e-12],
        [0, 0, 0, 0, 1e-12],
        [0, 0, 0, 0, 0, 1e-12],
    ]
    assert text[21:] == ["COVARIANCE_STOP"]


OLD_OEM = """\
CCSDS_OEM_VERS = 2.0
COMMENT after the example of CCSDS 502.0-B, figure 5-1
CREATION_DATE = 1996-11-04T17:22:31
ORIGINATOR = NASA/JPL
META_START
OBJECT_NAME = MARS GLOBAL SURVEYOR
OBJECT_ID = 1996-062A
CENTER_NAME = MARS BARYCENTER
REF_FRAME = EME2000
TIME_SYSTEM = UTC
START_TIME = 1996-12-18T12:00:00.331
STOP_TIME = 1996-12-18T12:02:00.331
INTERPOLATION = HERMITE
INTERPOLATION_DEGREE = 7
META_STOP
1996-12-18T12:00:00.331 2789.619 -280.045 -1746.755 4.73372 -2.49586 -1.04195
1996-353T12:01:00.331Z 2783.419 -308.143 -1877.071 5.18604 -2.42124 -1.99608
1996-12-18T12:02:00.331 2776.033 -336.859 -2008.682 5.63678 -2.33951 -1.94687
COVARIANCE_START
EPOCH = 1996-12-18T12:01:00.331
COV_REF_FRAME = RTN
 3.331349e-04
 4.618927349220216e-04 6.782421e-04
-3.070007e-04 -4.221234e-04 3.231931e-04
-3.349365e-07 -4.686084e-07 2.484949e-07 4.296022e-10
-2.211832e-07 -2.864186e-07 1.798098e-07 2.608899e-10 1.767514e-10
-3.041346e-07 -4.989496e-07 3.540310e-07 1.869263e-10 1.008862e-10 6.224444e-10
COVARIANCE_STOP
"""
SECOND = OLD_OEM[OLD_OEM.index("META_START") : OLD_OEM.index("COVARIANCE_START")].replace(
    "T12:", "T13:"
)


def test_other_peoples_orbits_are_read(tmp_path: Path) -> None:
    path = tmp_path / "mgs.oem"
    path.write_text(OLD_OEM)
    made = read_oem(path)
    assert made.epoch == "1996-12-18T12:00:00.331"
    assert np.allclose(made.t, [0.0, 60.0, 120.0], rtol=0, atol=1e-9)
    assert np.allclose(made.r[1], [2783419.0, -308143.0, -1877071.0], rtol=1e-15)
    assert np.allclose(made.v[0], [4733.72, -2495.86, -1041.95], rtol=1e-14)
    assert (made.frame, made.center) == ("EME2000", "MARS BARYCENTER")
    assert made.covariance_frame == "RTN"
    assert made.covariance is not None
    assert made.covariance[0, 1, 0] == made.covariance[0, 0, 1] == pytest.approx(461.8927349220216)
    assert made.covariance_t is not None
    assert made.covariance_t.tolist() == pytest.approx([60.0])


def test_of_several_segments_one_must_be_chosen(tmp_path: Path) -> None:
    path = tmp_path / "mgs.oem"
    path.write_text(OLD_OEM + SECOND)
    with pytest.raises(cc.LogFormatError, match=r"mgs.oem: has 2 segments: .*segment=0 ... 1"):
        read_oem(path)
    assert read_oem(path, segment=0).covariance is not None
    second = read_oem(path, segment=1)
    assert second.epoch == "1996-12-18T13:00:00.331"
    assert second.covariance is second.covariance_t is second.covariance_frame is None
    with pytest.raises(cc.LogFormatError, match=r"segment, value 2: there are 2"):
        read_oem(path, segment=2)


def test_orbits_that_cannot_be_written_name_field_and_row(tmp_path: Path) -> None:
    t, r, v = orbit(3)
    path = tmp_path / "orbit.oem"

    def fails(match: str, error: type[Exception] = cc.InputError, **changed: Any) -> None:
        given = {"epoch": EPOCH, "t": t, "r": r, "v": v, **NAMES, **changed}
        with pytest.raises(error, match=match):
            write_oem(path, **given)
        assert list(tmp_path.iterdir()) == []

    gone = v.copy()
    gone[2, 1] = np.nan
    fails(r"v, row 2.*must be finite", v=gone)
    fails(r"r, row 0.*inside the Earth: give metres", r=r / 1e3)
    fails(r"r: has 2 rows for 3 times", r=r[:2])
    fails(r"t, row 1", t=[0.0, 0.0, 1.0])
    fails(r"epoch", epoch="yesterday")
    fails(r"covariance: has shape", covariance=np.eye(6))
    skew = np.tile(np.eye(6), (3, 1, 1))
    skew[1, 0, 5] = 0.1
    fails(r"covariance, row 1: .*symmetric", covariance=skew)
    fails(r"object_name.*line of text", object_name="A\nB")
    fails(r"frame.*line of text", frame="")
    fails(r"object_id.*line of text", object_id=7)
    with pytest.raises(cc.InputError, match="does not exist"):
        write_oem(tmp_path / "no" / "x.oem", EPOCH, t, r, v, **NAMES)


def test_a_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    t, r, v = orbit(3)
    path = tmp_path / "orbit.oem"
    write_oem(path, EPOCH, t, r, v, **NAMES)
    before = path.read_bytes()
    with pytest.raises(cc.InputError):
        write_oem(path, EPOCH, t, r * np.nan, v, **NAMES)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("-308.143", "abc", r"line 1[67]"),
        ("1996-353T12:01", "1996-367T12:01", r"oem.epoch, row 1, value '1996-367T12:01:00.331Z'"),
        ("12:02:00.331 2776", "12:00:30.331 2776", r"oem.epoch, row 2.*does not come after"),
        ("TIME_SYSTEM = UTC", "TIME_SYSTEM = MET", r"oem.epoch, value 'MET': the time system"),
        ("CCSDS_OEM_VERS", "VERS", "is no CCSDS message"),
        ("META_STOP\n", "", r"line \d+|KVN"),
        ("OBJECT_ID = 1996-062A\n", "", r"OBJECT_ID"),
    ],
)
def test_damaged_files_are_named_with_the_place(
    tmp_path: Path, old: str, new: str, message: str
) -> None:
    path = tmp_path / "bad.oem"
    assert old in OLD_OEM
    path.write_text(OLD_OEM.replace(old, new, 1))
    with pytest.raises(cc.InputError, match=message) as caught:
        read_oem(path)
    assert str(path) in str(caught.value)
    assert len(str(caught.value)) < 600


def test_not_a_message_at_all(tmp_path: Path) -> None:
    with pytest.raises(cc.LogFormatError, match="cannot be read"):
        read_oem(tmp_path / "none.oem")
    path = tmp_path / "bytes.oem"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(cc.LogFormatError, match="not a text file"):
        read_oem(path)
    path.write_text(OLD_OEM)
    with pytest.raises(cc.LogFormatError, match="is an OEM; needed is an AEM"):
        read_aem(path)


# --- attitude ---------------------------------------------------------------------


@SUFFIXES
def test_an_attitude_comes_back(tmp_path: Path, suffix: str) -> None:
    turns = Rotation.from_rotvec(np.outer(np.linspace(0, 9, 100), [0.1, -0.7, 0.6]))
    path = tmp_path / f"attitude{suffix}"
    write_aem(path, EPOCH, np.arange(100.0), turns, body="SC_BODY_2", **NAMES)
    back = read_aem(path)
    assert back.epoch == "2026-01-01T00:00:00.000"
    assert quaternion.angle_between(back.q, turns).max() < 1e-15
    assert np.linalg.norm(np.diff(back.q, axis=0), axis=1).max() < 0.1
    assert (back.q[:, 0] < 0).any()
    assert (back.frame, back.body) == ("GCRF", "SC_BODY_2")
    assert (back.object_name, back.object_id, back.originator) == (
        "SAT 1",
        "2026-001A",
        "celestcore",
    )


def test_the_text_of_an_attitude_is_as_the_standard_wants_it(tmp_path: Path) -> None:
    """Body x points along inertial y: the frame turns by +90 degrees about z from A to B."""
    path = tmp_path / "attitude.aem"
    q_ib = quaternion.exp([0.0, 0.0, np.pi / 2])
    assert np.allclose(quaternion.rotate(q_ib, [1.0, 0, 0]), [0, 1.0, 0])
    write_aem(path, EPOCH, [0.0], [q_ib], creation_date="2026-02-03T04:05:06", **NAMES)
    text = [re.sub(r" +", " ", line) for line in lines(path) if line]
    assert text[:13] == [
        "CCSDS_AEM_VERS = 2.0",
        "CREATION_DATE = 2026-02-03T04:05:06",
        "ORIGINATOR = celestcore",
        "META_START",
        "OBJECT_NAME = SAT 1",
        "OBJECT_ID = 2026-001A",
        "REF_FRAME_A = GCRF",
        "REF_FRAME_B = SC_BODY_1",
        "TIME_SYSTEM = UTC",
        "START_TIME = 2026-01-01T00:00:00.000",
        "STOP_TIME = 2026-01-01T00:00:00.000",
        "ATTITUDE_TYPE = QUATERNION",
        "META_STOP",
    ]
    data = text[text.index("DATA_START") + 1].split()
    half = np.sqrt(0.5)  # axis z, angle 90 degrees: sin and cos of 45 degrees
    assert data[0] == "2026-01-01T00:00:00.000"
    assert np.allclose([float(x) for x in data[1:]], [0, 0, half, half], rtol=0, atol=1e-15)
    # the matrix that CCSDS makes of these numbers takes components in A to components in B
    q1, q2, q3, qc = (float(x) for x in data[1:])
    vector = np.array([q1, q2, q3])
    cross = np.array([[0, -q3, q2], [q3, 0, -q1], [-q2, q1, 0]])
    m = (qc**2 - vector @ vector) * np.eye(3) + 2 * np.outer(vector, vector) - 2 * qc * cross
    assert np.allclose(m @ [0, 1.0, 0], [1.0, 0, 0])


OLD_AEM = """\
CCSDS_AEM_VERS = 1.0
CREATION_DATE = 2002-11-04T17:22:31
ORIGINATOR = NASA/JPL
META_START
OBJECT_NAME = MARS GLOBAL SURVEYOR
OBJECT_ID = 1996-062A
CENTER_NAME = MARS BARYCENTER
REF_FRAME_A = EME2000
REF_FRAME_B = SC_BODY_1
ATTITUDE_DIR = A2B
TIME_SYSTEM = UTC
START_TIME = 1996-11-28T21:29:07.2555
STOP_TIME = 1996-11-28T21:31:08.2555
ATTITUDE_TYPE = QUATERNION
QUATERNION_TYPE = FIRST
INTERPOLATION_METHOD = HERMITE
INTERPOLATION_DEGREE = 7
META_STOP
DATA_START
1996-11-28T21:29:07.2555 0.68427 0.56748 0.03146 0.45689
1996-11-28T21:30:08.2555 0.74533 0.42319 -0.45697 0.23784
1996-11-28T21:31:08.2555 0.45652 -0.84532 0.26974 -0.06532
DATA_STOP
"""
FIRST = np.array([0.68427, 0.56748, 0.03146, 0.45689])


def _old(tmp_path: Path, *changes: tuple[str, str]) -> Path:
    text = OLD_AEM
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    path = tmp_path / "old.aem"
    path.write_text(text)
    return path


def test_version_1_with_its_direction_and_scalar(tmp_path: Path) -> None:
    known = FIRST / np.linalg.norm(FIRST)
    made = read_aem(_old(tmp_path))
    assert np.allclose(made.q[0], known, rtol=0, atol=1e-15)
    assert np.allclose(made.t, [0.0, 61.0, 121.0], rtol=0, atol=1e-9)
    assert (made.frame, made.body) == ("EME2000", "SC_BODY_1")
    back = read_aem(_old(tmp_path, ("A2B", "B2A")))
    assert np.allclose(back.q[0], known * [1, -1, -1, -1], rtol=0, atol=1e-15)
    last = read_aem(_old(tmp_path, ("FIRST", "LAST")))
    assert np.allclose(last.q[0], np.roll(known, 1), rtol=0, atol=1e-15)


def test_version_1_in_xml_names_its_numbers(tmp_path: Path) -> None:
    q = quaternion.exp([0.1, 0.2, 0.3])
    path = tmp_path / "old.xml"
    write_aem(path, EPOCH, [0.0], [q], **NAMES)
    text = path.read_text().replace('version="2.0"', 'version="1.0"')
    keywords = "<ATTITUDE_DIR>B2A</ATTITUDE_DIR><QUATERNION_TYPE>FIRST</QUATERNION_TYPE>"
    path.write_text(text.replace("</ATTITUDE_TYPE>", "</ATTITUDE_TYPE>" + keywords))
    assert quaternion.angle_between(read_aem(path).q[0], quaternion.conjugate(q)) < 1e-15


def test_from_the_spacecraft_outward_is_turned_round(tmp_path: Path) -> None:
    known = FIRST / np.linalg.norm(FIRST)
    path = _old(
        tmp_path,
        ("FRAME_A = EME2000", "FRAME_A = SC_BODY_1"),
        ("FRAME_B = SC_BODY_1", "FRAME_B = X"),
    )
    made = read_aem(path)
    assert (made.frame, made.body) == ("X", "SC_BODY_1")
    assert np.allclose(made.q[0], known * [1, -1, -1, -1], rtol=0, atol=1e-15)
    path = _old(
        tmp_path,
        ("FRAME_A = EME2000", "FRAME_A = SC_BODY_1"),
        ("FRAME_B = SC_BODY_1", "FRAME_B = EME2000"),
        ("A2B", "B2A"),
    )
    assert "REF_FRAME_B = EME2000" in path.read_text()
    assert np.allclose(read_aem(path).q[0], known, rtol=0, atol=1e-15)


def test_wrong_attitudes_are_named(tmp_path: Path) -> None:
    for change, message in (
        (("A2B", "AB"), r"direction, value .*must be B2A or A2B"),
        (("FIRST", "MIDDLE"), r"scalar, value .*must be FIRST or LAST"),
        (("0.74533", "0.2"), r"aem.quaternion, row 1.*norm"),
        (("0.74533", "x"), r"line 2\d"),
        (("21:30:08.2555", "21:29:07.2555"), r"aem.epoch, row 1.*does not come after"),
    ):
        with pytest.raises(cc.InputError, match=message) as caught:
            read_aem(_old(tmp_path, change))
        assert "old.aem" in str(caught.value)
    path = tmp_path / "new.aem"
    for q, message in (
        ([[1.0, 0, 0, 0], [2.0, 0, 0, 0]], r"q_ib, row 1.*norm 2"),
        ([[1.0, 0, 0, 0], [np.nan] * 4], r"q_ib, row 1.*finite"),
        ([[1.0, 0, 0, 0]], r"q_ib: has 1 rows for 2 times"),
    ):
        with pytest.raises(cc.InputError, match=message):
            write_aem(path, EPOCH, [0.0, 1.0], q, **NAMES)
    assert not path.exists()


# --- the library --------------------------------------------------------------------


def test_without_the_library_one_sentence_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    path = tmp_path / "x.oem"
    path.write_text(OLD_OEM)
    monkeypatch.setitem(sys.modules, "ccsds_ndm", None)
    with pytest.raises(cc.errors.MissingDependencyError, match=r"celestcore\[ccsds\]"):
        read_oem(path)
    monkeypatch.setitem(sys.modules, "ccsds_ndm", types.ModuleType("ccsds_ndm"))
    with pytest.raises(cc.errors.MissingDependencyError, match="uninstall ccsds-ndm"):
        write_aem(path, EPOCH, [0.0], [[1.0, 0, 0, 0]], **NAMES)


def test_a_real_attitude_survives(tmp_path: Path) -> None:
    star = cc.sample("noaa20").stars["star"]
    path = tmp_path / "noaa20.aem"
    write_aem(
        path, "2021-04-09T00:00:00", star.t, star.q, object_name="NOAA-20", object_id="2017-073A"
    )
    back = read_aem(path)
    assert back.epoch.startswith("2021-04-08T23:59:59.93")
    assert np.abs(back.t + star.t[0] - star.t).max() < 2e-9
    assert quaternion.angle_between(back.q, star.q).max() < 1e-15
