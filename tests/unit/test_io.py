"""Logs on disk: what is written is read back exactly; what is broken is said clearly."""

from __future__ import annotations

import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from celestcore.errors import (
    CelestcoreWarning,
    InputError,
    LogFormatError,
    MissingDependencyError,
)
from celestcore.io import read_log, write_log
from celestcore.log import SensorLog
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

Array = np.ndarray[Any, Any]
NAMES = ("log", "log.npz", "log.csv")
T = np.arange(8.0)
RATE = np.random.default_rng(1).standard_normal((8, 3)) * 1e-3
Q = np.random.default_rng(2).standard_normal((8, 4))
Q /= np.linalg.norm(Q, axis=1)[:, None]
SETTINGS: dict[str, Any] = {
    "log": {"source": 'a "test"\\\n\x7f', "licence": "CC0"},
    "gyro": {"arw": 1e-6, "mounting": [1.0, 0.0, 0.0, 0.0], "sampling": "hold"},
    "star": {"sigma_arcsec": [5, 5, 20.5]},
    "filter": {"kind": "ukf", "kappa": 0},
}


def simple(**more: Any) -> SensorLog:
    return SensorLog(gyro=(T, RATE), star=(T[::2], Q[::2]), **more)


def assert_same(a: SensorLog, b: SensorLog) -> None:
    """The same tables, bit for bit, and the same words about them."""
    assert set(a.tables) == set(b.tables)
    for name, table in a.tables.items():
        for key in set(vars(table)) - {"missing", "kept"}:
            one, two = getattr(table, key), getattr(b.tables[name], key)
            assert (one is None) == (two is None), (name, key)
            if one is not None:
                assert np.array_equal(one, two, equal_nan=True), (name, key)
    assert (a.title, a.epoch, a.frames) == (b.title, b.epoch, b.frames)


# ------------------------------------------------------------------ round trips

finite = st.floats(allow_nan=False, allow_infinity=False)


@st.composite
def logs(draw: st.DrawFn) -> SensorLog:
    """Logs with every kind of table, awkward floats, and times that meet or do not."""

    def times() -> Array:
        some = st.one_of(st.integers(0, 12).map(float), st.floats(-1e8, 1e8))
        values = draw(st.lists(some, min_size=1, max_size=6, unique=True))
        return np.array(sorted(values))

    def rows(n: int, k: int, elements: st.SearchStrategy[float] = finite) -> Array:
        return draw(hnp.arrays(np.float64, (n, k), elements=elements))

    def units(n: int, k: int) -> Array:
        v = rows(n, k, st.floats(-1.0, 1.0)) + np.eye(k)[0] * 2.0
        return np.asarray(v / np.linalg.norm(v, axis=1)[:, None])

    tables: dict[str, Any] = {}
    kinds = ["gyro", "star", "star_1", "star_aft_2", "vector_sun", "vector_x_t"]
    kinds += ["gnss", "baselines"]
    for name in draw(st.lists(st.sampled_from(kinds), min_size=1, max_size=8, unique=True)):
        t = times()
        n = len(t)
        if name == "gyro":
            tables[name] = (t, rows(n, 3))
        elif name == "gnss":
            place = units(n, 3) * 1e7 + rows(n, 3, st.floats(-1e6, 1e6))
            tables[name] = (t, place) + ((rows(n, 3),) if draw(st.booleans()) else ())
        elif name == "baselines":
            k = draw(st.integers(2, 4))
            b = rows(n, 3 * k, st.floats(0.1, 1e5)).reshape(n, k, 3)
            b[:, 1:][rows(n, k - 1, st.floats(0.0, 1.0)) > 0.7] = np.nan
            tables[name] = (t, b)
        elif name.startswith("vector"):
            sigma = (rows(n, 1, st.floats(1e-300, 0.4))[:, 0],) if draw(st.booleans()) else ()
            tables[name] = (t, units(n, 3), units(n, 3), *sigma)
        else:
            noise = draw(st.sampled_from(["", "sigma", "covariance"]))
            tables[name] = (t, units(n, 4))
            if noise == "sigma":
                tables[name] += (rows(n, 3, st.floats(1e-300, 0.4)),)
            elif noise:
                f = rows(n, 9, st.floats(-0.1, 0.1)).reshape(n, 3, 3)
                tables[name] += (f @ f.transpose(0, 2, 1) + 0.01 * np.eye(3),)
    text = st.text(st.characters(codec="utf-8"), min_size=1)
    title, frames = draw(st.none() | text), draw(st.none() | st.just({"inertial": "GCRS"}))
    return SensorLog(title=title, frames=frames, epoch="2026-01-01T00:00:00", **tables)


@pytest.mark.filterwarnings("error", "ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=40)
@given(log=logs())
def test_round_trip_is_exact(name: str, log: SensorLog) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write_log(log, path)
        once = read_log(path)
        assert_same(log, once)
        write_log(once, path)
        assert_same(log, read_log(path))


@pytest.mark.parametrize("name", NAMES)
def test_settings_survive(name: str, tmp_path: Path) -> None:
    log = simple(settings=SETTINGS, title="a title", frames={"body": "bus"})
    write_log(log, tmp_path / name)
    again = read_log(tmp_path / name)
    assert again.settings == {
        **SETTINGS,
        "log": {**SETTINGS["log"], "title": "a title"},
        "frames": {"body": "bus"},
    }
    sidecar = tmp_path / ("log/log.toml" if name == "log" else "log.toml")
    assert sidecar.is_file()
    sidecar.unlink()
    assert read_log(tmp_path / name).settings == {}


@pytest.mark.parametrize("name", NAMES)
def test_a_log_without_words_has_no_toml(name: str, tmp_path: Path) -> None:
    write_log(simple(title="old"), tmp_path / name)
    write_log(simple(), tmp_path / name)
    assert read_log(tmp_path / name).title is None
    assert not list(tmp_path.rglob("*.toml"))


def test_missing_rows_are_counted_on_reading(tmp_path: Path) -> None:
    rate = RATE.copy()
    rate[3, 1] = np.nan
    columns = {"t": T, "wx": rate[:, 0], "wy": rate[:, 1], "wz": rate[:, 2]}
    keys: dict[str, Any] = {f"gyro_{k}": v for k, v in columns.items()}
    np.savez(tmp_path / "a.npz", **keys)
    (tmp_path / "d").mkdir()
    masked = {k: pa.array(v, mask=np.isnan(v)) for k, v in columns.items()}
    pq.write_table(pa.table(masked), tmp_path / "d/gyro.parquet")
    lines = [",".join(map(repr, row)) for row in np.column_stack(list(columns.values())).tolist()]
    (tmp_path / "c.csv").write_text("\n".join(["t,wx,wy,wz", *lines, ""]))
    (tmp_path / "b.csv").write_text("\n".join(["t,wx,wy,wz", *lines, ""]).replace("nan", ""))
    for path in ("a.npz", "d", "c.csv", "b.csv"):
        log = read_log(tmp_path / path)
        assert log.gyro is not None
        assert (len(log.gyro), log.gyro.missing) == (7, 1), path
        assert log.gyro.rows.tolist() == [0, 1, 2, 4, 5, 6, 7]


# ------------------------------------------------------------------ reading what others wrote


@pytest.mark.parametrize(
    "kind", [pa.float32(), pa.int8(), pa.uint64(), pa.float64(), pa.float16(), pa.int64()]
)
def test_parquet_of_any_number_type(kind: Any, tmp_path: Path) -> None:
    values = pa.array([0, 1, 2]).cast(pa.float32()).cast(kind)
    table = pa.table(dict.fromkeys(("wz", "t", "wy", "wx"), values))
    pq.write_table(table, tmp_path / "gyro.parquet")
    log = read_log(tmp_path)
    assert log.gyro is not None
    assert np.array_equal(log.gyro.rate[:, 0], [0.0, 1.0, 2.0])


def test_npz_of_other_dtypes_and_compressed(tmp_path: Path) -> None:
    np.savez_compressed(
        tmp_path / "a.npz",
        gyro_t=np.arange(3, dtype=">i4"),
        gyro_wx=np.arange(3, dtype=">f4"),
        gyro_wy=np.arange(6.0)[::2],
        gyro_wz=np.arange(3, dtype="f2"),
    )
    log = read_log(tmp_path / "a.npz")
    assert log.gyro is not None
    assert np.array_equal(log.gyro.rate[2], [2.0, 4.0, 2.0])


def test_csv_by_hand(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(
        b'\xef\xbb\xbf t , "wx",wy,wz, qw,qx,qy,qz\r\n'
        b"0, 1e-3,0,-0.5,1,0,0,0\r\n"
        b"1,2E-3, 0 ,+0.5,,,,\r\n"
        b"2,,,,-1,0,0,0\r\n"
        b"3,NaN,0,0,NA,NA,NA,NA\r\n"
        b"4,4e-3,0,0,1,0,,0\r\n"
    )
    log = read_log(path)
    star = log.stars["star"]
    assert log.gyro is not None
    assert log.gyro.t.tolist() == [0.0, 1.0, 4.0]
    assert log.gyro.rate[1].tolist() == [2e-3, 0.0, 0.5]
    assert log.gyro.missing == 1  # the NaN; a blank is no sample, not a missing one
    assert star.t.tolist() == [0.0, 2.0]
    assert star.missing == 1  # the fix that is only partly there


def test_csv_header_is_plain_for_gyro_and_star_only(tmp_path: Path) -> None:
    write_log(simple(), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_text().startswith("t,wx,wy,wz,qw,qx,qy,qz\n0,")
    write_log(simple(star_1=(T, Q)), tmp_path / "b.csv")
    assert (tmp_path / "b.csv").read_text().startswith("t,gyro_wx,gyro_wy,gyro_wz,star_qw,")


def test_columns_that_are_no_columns_of_a_log_are_named(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,wx,wy,wz,temp\n0,0,0,0,20\n")
    np.savez(tmp_path / "b.npz", gyro_t=[0], gyro_wx=[0], gyro_wy=[0], gyro_wz=[0], gyro_temp=[1])
    (tmp_path / "d").mkdir()
    table = {"t": [0.0], "wx": [0.0], "wy": [0.0], "wz": [0.0], "temp": [0.0]}
    pq.write_table(pa.table(table), tmp_path / "d/gyro.parquet")
    for path, name in (("a.csv", "temp"), ("b.npz", "gyro_temp"), ("d", "temp")):
        with pytest.warns(CelestcoreWarning, match=f"ignored .*: {name}$"):
            assert len(read_log(tmp_path / path)) == 1


@pytest.mark.filterwarnings("error")
def test_good_files_do_not_warn(tmp_path: Path) -> None:
    for name in NAMES:
        write_log(simple(title="t"), tmp_path / name)
        read_log(str(tmp_path / name))


# ------------------------------------------------------------------ writing


def snapshot(folder: Path) -> dict[str, bytes]:
    return {str(p.relative_to(folder)): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("name", NAMES)
def test_a_failed_write_leaves_the_old_log(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(simple(title="old"), tmp_path / name)
    before = snapshot(tmp_path)

    def fail(*_: Any, **__: Any) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez", fail)
    monkeypatch.setattr("pyarrow.csv.write_csv", fail)
    monkeypatch.setattr("pyarrow.parquet.write_table", fail)
    with pytest.raises(LogFormatError, match="No space left"):
        write_log(simple(title="new"), tmp_path / name)
    assert snapshot(tmp_path) == before
    assert sorted(p.name for p in tmp_path.iterdir()) == sorted(
        {name, "log.toml"} if "." in name else {name}
    )


@pytest.mark.parametrize("name", ["no/log", "no/log.npz", "no/log.csv"])
def test_a_missing_parent_directory(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist: create it first"):
        write_log(simple(), tmp_path / name)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["a.txt", "gyro.parquet", "log.toml"])
def test_endings_that_are_no_log(name: str, tmp_path: Path) -> None:
    with pytest.raises(LogFormatError, match="no kind of log"):
        write_log(simple(), tmp_path / name)


def test_writing_a_directory_replaces_the_tables_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "log"
    write_log(simple(star_1=(T, Q), title="old"), path)
    (path / "notes.txt").write_text("mine")
    write_log(simple(), path)
    assert sorted(p.name for p in path.iterdir()) == ["gyro.parquet", "notes.txt", "star.parquet"]
    assert list(read_log(path).stars) == ["star"]
    assert [p.name for p in tmp_path.iterdir()] == ["log"]


def test_tables_of_later_versions_are_ignored_with_a_warning(tmp_path: Path) -> None:
    path = tmp_path / "log"
    write_log(simple(), path)
    for name in ("angle", "horizon"):
        pq.write_table(pa.table({"t": [0.0], "angle": [0.1]}), path / f"{name}.parquet")
    words = "log: ignored what is no table of a log: angle.parquet, horizon.parquet$"
    with pytest.warns(CelestcoreWarning, match=words):
        assert_same(simple(), read_log(path))


def test_a_directory_may_have_a_dot(tmp_path: Path) -> None:
    path = tmp_path / "run.2026"
    path.mkdir()
    write_log(simple(), path)
    assert_same(simple(), read_log(path))


@pytest.mark.parametrize("name", ["log", "log.csv"])
def test_without_pyarrow_one_sentence(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_log(simple(), tmp_path / name)
    shutil.copytree(tmp_path, tmp_path / "copy")
    for module in [m for m in sys.modules if m.partition(".")[0] == "pyarrow"] + ["pyarrow"]:
        monkeypatch.setitem(sys.modules, module, None)
    for action in (lambda: read_log(tmp_path / name), lambda: write_log(simple(), tmp_path / name)):
        with pytest.raises(MissingDependencyError, match=r"pip install 'celestcore\[parquet\]'"):
            action()
    write_log(simple(), tmp_path / "a.npz")
    assert_same(simple(), read_log(tmp_path / "a.npz"))
