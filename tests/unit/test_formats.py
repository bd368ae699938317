"""Logs as streams: every format gives what went in, in chunks and in windows of any length."""

from __future__ import annotations

import io
import itertools
import json
import sys
import threading
from collections.abc import Iterator
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from celestcore import cli
from celestcore.errors import (
    CelestcoreWarning,
    InputError,
    LogFormatError,
    MissingDependencyError,
)
from celestcore.formats import Format, Lane, Source, Stamps, _registry, formats, open_log
from celestcore.formats._stream import LogStream
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

Columns = dict[str, Any]
NAMES = ("log", "log.npz", "log.csv", "log.h5")
EPOCH = "2026-01-01T00:00:00"
RNG = np.random.default_rng(5)


def unit(n: int) -> np.ndarray[Any, Any]:
    q = RNG.standard_normal((n, 4))
    return np.asarray(q / np.linalg.norm(q, axis=1)[:, None])


def sample(gyro: int = 1000, star: int = 95, gnss: int = 13) -> cc.SensorLog:
    return cc.SensorLog(
        epoch=EPOCH,
        gyro=(np.arange(gyro) * 0.1, 1e-3 * RNG.standard_normal((gyro, 3))),
        star=(0.05 + np.arange(star), unit(star)),
        star_2=(3.0 + np.arange(star) * 0.5, unit(star), 1e-5),
        gnss=(np.arange(gnss) * 7.0, RNG.normal([7e6, 0.0, 0.0], 1.0, (gnss, 3))),
    )


LOG = sample()


def columns_of(log: cc.SensorLog) -> dict[str, Columns]:
    from celestcore._columns import columns_from_table

    return {name: columns_from_table(table) for name, table in log.tables.items()}


def gathered(pieces: Any) -> dict[str, Columns]:
    parts: dict[str, list[Columns]] = {}
    for name, columns in pieces:
        parts.setdefault(name, []).append(columns)
    return {n: {c: np.concatenate([p[c] for p in ps]) for c in ps[0]} for n, ps in parts.items()}


def same(a: dict[str, Columns], b: dict[str, Columns]) -> None:
    assert set(a) == set(b)
    for name, columns in a.items():
        assert next(iter(columns)) == "t"
        assert set(columns) == set(b[name])
        for column, values in columns.items():
            assert values.dtype == np.float64
            assert np.array_equal(values, b[name][column]), (name, column)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs")
    for name in NAMES:
        cc.write_log(LOG, path / name)
    return path


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("chunk_rows", [1, 7, 64, 100_000])
def test_chunks_joined_are_the_log(folder: Path, name: str, chunk_rows: int) -> None:
    with open_log(folder / name, chunk_rows=chunk_rows) as stream:
        assert stream.epoch == EPOCH
        assert set(stream.sensors) == set(LOG.tables)
        pieces = list(stream)
        if name != "log.csv":
            assert max(len(c["t"]) for _, c in pieces) <= chunk_rows
        same(gathered(pieces), columns_of(LOG))
        same(gathered(stream), columns_of(LOG))


@pytest.mark.parametrize("name", NAMES)
def test_read_log_reads_the_same(folder: Path, name: str) -> None:
    log = cc.read_log(folder / name)
    same(columns_of(log), columns_of(LOG))
    assert log.epoch == EPOCH


@pytest.mark.parametrize("ahead", [0, 1, 3])
@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=6, suppress_health_check=list(HealthCheck))
@given(
    seconds=st.floats(0.01, 200.0),
    start=st.none() | st.floats(-10.0, 120.0),
    chunk_rows=st.integers(1, 300),
    reorder=st.none() | st.floats(0.0, 20.0),
)
def test_windows_hold_every_row_once(
    folder: Path,
    name: str,
    ahead: int,
    seconds: float,
    start: float | None,
    chunk_rows: int,
    reorder: float | None,
) -> None:
    with open_log(folder / name, chunk_rows=chunk_rows, reorder=reorder) as stream:
        found = list(stream.windows(seconds, start=start, ahead=ahead))
    for window in found:
        assert window.tables
        for columns in window.tables.values():
            assert window.start <= columns["t"][0]
            assert columns["t"][-1] < window.stop
    assert all(a.stop <= b.start for a, b in itertools.pairwise(found))
    whole = columns_of(LOG)
    if start is not None:
        kept = {n: c["t"] >= start for n, c in whole.items()}
        whole = {n: {k: v[kept[n]] for k, v in c.items()} for n, c in whole.items()}
        whole = {n: c for n, c in whole.items() if len(c["t"])}
    same(gathered((n, c) for w in found for n, c in w.tables.items()), whole)


def test_a_window_becomes_a_log(folder: Path) -> None:
    with open_log(folder / "log") as stream:
        window = next(iter(stream.windows(10.0)))
    log = window.log()
    assert log.epoch == EPOCH
    assert len(log.stars["star_2"]) == 14
    assert log.stars["star_2"].sigma is not None


def test_windows_of_a_log_with_a_long_gap_skip_it() -> None:
    t = np.array([0.0, 1.0, 1e9, 1e9 + 1.0])
    chunk = {"gyro": {"t": t, "wx": t, "wy": t, "wz": t}}
    stream = made(lambda rows: iter([chunk]))
    assert [(w.start, w.stop) for w in stream.windows(2.0)] == [(0.0, 2.0), (1e9, 1e9 + 2.0)]


def made(read: Any, sensors: Any = None, **options: Any) -> LogStream:
    """Return a stream of a reader that a test makes up."""
    names = {"gyro": ("t", "wx", "wy", "wz")} if sensors is None else sensors
    skew = options.pop("skew", 0.0)
    mine = Format(name="mine", summary="", read=lambda s: Source((Lane(names, read, skew),)))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("celestcore.formats._stream.choose", lambda source, name: mine)
        return open_log(io.BytesIO(), **options)


@settings(deadline=None)
@given(
    seed=st.integers(0, 2**32 - 1),
    seconds=st.floats(0.3, 20.0),
    reorder=st.floats(0.0, 3.0),
    rows=st.integers(1, 20),
)
def test_sensors_that_share_a_lane_may_be_apart(
    seed: int, seconds: float, reorder: float, rows: int
) -> None:
    rng = np.random.default_rng(seed)
    skew = 2.0
    t = {"gyro": np.arange(0.0, 50.0, 0.25), "gnss": np.arange(0.1, 50.0, 3.0)}
    names = {"gyro": ("t", "wx", "wy", "wz"), "gnss": ("t", "x", "y", "z")}
    arrival = {n: a + rng.uniform(0.0, reorder, len(a)) for n, a in t.items()}
    arrival["gnss"] += rng.uniform(0.0, skew)
    events = sorted((a, n, k) for n in t for k, a in enumerate(arrival[n]))

    def read(chunk_rows: int) -> Iterator[dict[str, Columns]]:
        for first in range(0, len(events), rows):
            part = events[first : first + rows]
            yield {
                n: dict.fromkeys(names[n], t[n][[k for _, m, k in part if m == n]])
                for n in {m for _, m, _ in part}
            }

    stream = made(read, names, skew=skew, reorder=reorder)
    found = list(stream.windows(seconds, ahead=0))
    assert all(r.late == 0 for r in stream.reports.values())
    joined = gathered((n, c) for w in found for n, c in w.tables.items())
    for name, times in t.items():
        assert np.array_equal(joined[name]["t"], times)


def test_sensors_of_other_rates_are_not_read_further_than_needed() -> None:
    """A fast and a slow sensor, endless: of each no more than a chunk waits."""
    read_to = {"gyro": 0.0, "gnss": 0.0}

    def lane(name: str, rate: float, columns: str) -> Lane:
        names = ("t", *columns.split())

        def read(rows: int) -> Iterator[dict[str, Columns]]:
            for k in range(10**9):
                t = (k * rows + np.arange(rows)) / rate
                read_to[name] = t[-1]
                yield {name: dict.fromkeys(names, t)}

        return Lane({name: names}, read)

    lanes = (lane("gyro", 1000.0, "wx wy wz"), lane("gnss", 1.0, "x y z"))
    mine = Format(name="mine", summary="", read=lambda s: Source(lanes))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("celestcore.formats._stream.choose", lambda source, name: mine)
        stream = open_log(io.BytesIO(), chunk_rows=50)
    for k, window in enumerate(stream.windows(1.0, ahead=0)):
        assert len(window.tables["gyro"]["t"]) == 1000
        assert read_to["gyro"] <= window.stop + 0.05
        assert read_to["gnss"] <= window.stop + 50.0
        if k == 200:
            break


def test_leaving_a_window_loop_ends_the_thread(folder: Path) -> None:
    before = threading.active_count()
    stream = open_log(folder / "log", chunk_rows=10)
    for window in stream.windows(1.0):
        assert window.start == 0.0
        break
    windows = stream.windows(1.0)
    next(windows)
    stream.close()
    assert list(windows) == []
    assert threading.active_count() == before


# ------------------------------------------------------------------ Parquet as datasets


def gyro_table(t: Any) -> pa.Table:
    t = np.asarray(t, dtype=float)
    return pa.table({"t": t, "wx": t, "wy": 2 * t, "wz": 3 * t})


def test_a_partitioned_directory_per_sensor(tmp_path: Path) -> None:
    for day, first in (("9", 900), ("10", 1000), ("1", 100)):
        part = tmp_path / "gyro" / f"day={day}"
        part.mkdir(parents=True)
        pq.write_table(gyro_table(first + np.arange(100)), part / "part-0.parquet")
    (tmp_path / "gyro" / "_metadata").write_bytes(b"x")
    (tmp_path / "gyro" / "_old").mkdir()
    (tmp_path / "gyro" / "_old" / "part.parquet").write_bytes(b"x")
    pq.write_table(
        pa.table({"t": [1.0], "x": [7e6], "y": [1.0], "z": [1.0]}), tmp_path / "gnss.parquet"
    )
    log = cc.read_log(tmp_path)
    assert log.gyro is not None
    assert log.gyro.t[[0, 100, 200, 299]].tolist() == [100.0, 900.0, 1000.0, 1099.0]
    assert log.gnss is not None


def test_a_dataset_partitioned_by_sensor(tmp_path: Path) -> None:
    pq.write_to_dataset(
        gyro_table(np.arange(10)).append_column("sensor", [["gyro"] * 10]),
        tmp_path,
        partition_cols=["sensor"],
    )
    assert len(cc.read_log(tmp_path)) == 10


def test_one_parquet_file(tmp_path: Path) -> None:
    path = tmp_path / "recording.parquet"
    pq.write_table(gyro_table(np.arange(10)), path)
    with pytest.raises(LogFormatError, match="give the directory"):
        open_log(path)
    assert len(open_log(path, table="gyro").read()) == 10
    with path.open("rb") as file:
        assert len(open_log(file, format="parquet", table="gyro").read()) == 10
        with pytest.raises(InputError, match="format"):
            open_log(file)


def test_parts_of_a_dataset_must_hold_the_same_columns(tmp_path: Path) -> None:
    (tmp_path / "star").mkdir()
    q = {"qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]}
    s = {"sx": [1e-5], "sy": [1e-5], "sz": [1e-5]}
    pq.write_table(pa.table({"t": [0.0], **q, **s}), tmp_path / "star" / "1.parquet")
    pq.write_table(pa.table({"t": [1.0], **q}), tmp_path / "star" / "2.parquet")
    with pytest.raises(LogFormatError, match="has no sx, sy, sz"):
        cc.read_log(tmp_path)


def test_timestamps_in_parquet_and_iso_times_in_csv(tmp_path: Path) -> None:
    t = np.array(["2016-12-31T23:59:59.5", "2017-01-01T00:00:00.5"], dtype="M8[us]")
    table = gyro_table([0.0, 0.0]).set_column(0, "t", pa.array(t))
    pq.write_table(table, tmp_path / "gyro.parquet")
    log = cc.read_log(tmp_path)
    assert log.epoch == "2016-12-31T23:59:59"
    assert log.gyro is not None
    assert log.gyro.t.tolist() == [0.5, 2.5]
    (tmp_path / "a.csv").write_text(
        "t,wx,wy,wz\n2016-12-31T23:59:59.5Z,0,0,0\n2016-12-31T23:59:60.5Z,0,0,0\n"
        "2017-01-01T00:00:00.5Z,0,0,0\n"
    )
    log = cc.read_log(tmp_path / "a.csv", epoch="2016-12-31T23:59:58")
    assert log.gyro is not None
    assert log.gyro.t.tolist() == [1.5, 2.5, 3.5]


def test_sensors_with_clocks_of_their_own(tmp_path: Path) -> None:
    gps = 1451260818.0 + np.arange(5)
    pq.write_table(
        gyro_table((np.arange(5) * 1000 + 2**32 - 2500) % 2**32), tmp_path / "gyro.parquet"
    )
    xyz = dict.fromkeys("xyz", np.full(5, 7e6))
    pq.write_table(pa.table({"t": gps, **xyz}), tmp_path / "gnss.parquet")
    stamps = {
        "gnss": Stamps(scale="GPS", since="1980-01-06"),
        "gyro": Stamps(unit=1e-3, bits=32, since=None),
    }
    stream = open_log(tmp_path, stamps=stamps)
    log = stream.read()
    assert log.epoch == EPOCH
    assert log.gnss is not None
    assert log.gnss.t.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert log.gyro is not None
    assert np.diff(log.gyro.t) == pytest.approx(1.0)
    assert stream.reports["gyro"].wraps == 1


def test_disorder_is_put_right_and_reported(tmp_path: Path) -> None:
    pq.write_table(gyro_table([0, 2, 1, 3, 3, 9, 4, 10]), tmp_path / "gyro.parquet")
    with pytest.raises(InputError, match=r"gyro.t, row 2"):
        cc.read_log(tmp_path)
    stream = open_log(tmp_path, reorder=2.0)
    log = stream.read()
    assert log.gyro is not None
    assert log.gyro.t.tolist() == [0, 1, 2, 3, 9, 10]
    assert stream.reports["gyro"].troubles == {"reordered": 1, "late": 1, "repeated": 1}


def test_read_log_warns_of_rows_left_out(tmp_path: Path) -> None:
    pq.write_table(gyro_table([0, 2, 1, 3, 3, 9, 4, 10]), tmp_path / "gyro.parquet")
    with pytest.warns(CelestcoreWarning, match="gyro: of 8 rows .*: 1 late, 1 repeated$"):
        assert len(cc.read_log(tmp_path, reorder=2.0)) == 6


@pytest.mark.parametrize("start", [-1.0, 0.0, 99.95, 500.0, 799.9, 1e4])
@pytest.mark.parametrize("reorder", [None, 1.0])
def test_a_late_start_does_not_read_what_is_before(
    start: float, reorder: float | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "gyro").mkdir()
    t = np.arange(8000) * 0.1
    for k in range(2):
        part = gyro_table(t[4000 * k : 4000 * (k + 1)])
        pq.write_table(part, tmp_path / "gyro" / f"{k}.parquet", row_group_size=500)
    stream = open_log(tmp_path, chunk_rows=100, reorder=reorder)
    found = list(stream.windows(30.0, start=start))
    got = np.concatenate([w.tables["gyro"]["t"] for w in found]) if found else np.empty(0)
    assert np.array_equal(got, t[t >= start])
    assert stream.reports["gyro"].rows <= np.sum(t >= start) + 500
    damaged = tmp_path / "gyro" / "1.parquet"
    pq.write_table(
        gyro_table(np.where(t == t[7000], np.nan, t)[4000:]), damaged, row_group_size=500
    )
    if start == 500.0 and reorder is None:
        with pytest.raises(InputError, match=r"gyro.t, row 7000, value nan"):
            list(stream.windows(30.0, start=start))


def test_a_log_whose_clock_jumped_is_split(tmp_path: Path) -> None:
    pq.write_table(
        gyro_table([*range(10), *range(1000, 1010), *range(5, 15)]), tmp_path / "gyro.parquet"
    )
    xyz = dict.fromkeys("xyz", np.full(15, 7e6))
    t = [*range(0, 10, 2), *range(1000, 1010, 2), *range(6, 16, 2)]
    pq.write_table(pa.table({"t": np.array(t, dtype=float), **xyz}), tmp_path / "gnss.parquet")
    stream = open_log(tmp_path, reorder=0.0, jump=100.0, chunk_rows=4)
    parts = [part.read() for part in stream.split()]
    assert [p.gyro.t[[0, -1]].tolist() for p in parts if p.gyro] == [[0, 9], [1000, 1009], [5, 14]]
    assert [p.gnss.t.tolist() for p in parts if p.gnss] == [
        [0, 2, 4, 6, 8],
        [1000, 1002, 1004, 1006, 1008],
        [6, 8, 10, 12, 14],
    ]
    pq.write_table(pa.table({"t": np.arange(15.0), **xyz}), tmp_path / "gnss.parquet")
    with pytest.raises(InputError, match="differently often"):
        open_log(tmp_path, reorder=0.0, jump=100.0).split()
    with pytest.raises(InputError, match="jump"):
        open_log(tmp_path).split()


def test_wrong_arguments(folder: Path) -> None:
    for wrong in ({"chunk_rows": 0}, {"reorder": -1.0}, {"damaged": "no"}, {"jump": 1.0}):
        with pytest.raises(InputError):
            open_log(folder / "log", **wrong)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="is not one of"):
        open_log(folder / "log", format="nothing")
    with pytest.raises(InputError, match="seconds"):
        open_log(folder / "log").windows(0.0)


@pytest.mark.parametrize("name", ["log.npz", "log.csv", "log.h5"])
def test_file_objects(folder: Path, name: str) -> None:
    data = io.BytesIO((folder / name).read_bytes())
    kind = {"h5": "hdf5"}.get(name[4:], name[4:])
    stream = open_log(data, format=kind, epoch=EPOCH)
    same(gathered(stream), columns_of(LOG))
    same(gathered(stream), columns_of(LOG))


# ------------------------------------------------------------------ the registry


def test_a_reader_of_another_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def read(source: Any, scale: float = 1.0) -> Source:
        t = scale * np.loadtxt(source)
        chunk = {"gyro": dict.fromkeys(("t", "wx", "wy", "wz"), t)}
        return Source((Lane({"gyro": ("t", "wx", "wy", "wz")}, lambda rows: iter([chunk])),))

    module = type(sys)("their_package")
    module.mine = Format(name="mine", summary="their own", suffixes=(".mine",), read=read)  # type: ignore[attr-defined]
    module.other = 3  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "their_package", module)
    entries = [
        EntryPoint(name, f"their_package:{name}", _registry.GROUP)
        for name in ("mine", "other", "absent")
    ]
    monkeypatch.setattr(_registry, "entry_points", lambda group: entries)
    _registry._loaded.cache_clear()
    with pytest.warns(CelestcoreWarning) as caught:
        assert formats()["mine"].summary == "their own"
    words = " ".join(str(w.message) for w in caught)
    assert "their_package:other" in words
    assert "their_package:absent" in words
    (tmp_path / "a.mine").write_text("0 1 2")
    assert len(cc.read_log(tmp_path / "a.mine")) == 3
    assert open_log(tmp_path / "a.mine", scale=2.0).read().span == (0.0, 4.0)


def test_the_list_of_formats(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    assert cli.main(["formats", "--json", "-"]) == 0
    rows = json.loads(capsys.readouterr().out)
    by_name = {row["name"]: row for row in rows}
    assert set(by_name) >= {"parquet", "csv", "npz", "hdf5", "aem", "oem", "packets", "ck"}
    assert by_name["msopck"] == {
        "name": "msopck",
        "summary": by_name["msopck"]["summary"],
        "suffixes": [".msopck"],
        "reads": False,
        "writes": True,
        "install": None,
    }
    assert cli.main(["formats", "--json", str(tmp_path / "a.json")]) == 0
    assert json.loads((tmp_path / "a.json").read_text()) == rows
    assert "hdf5" in capsys.readouterr().out


MISSING = {
    "hdf5": ("h5py", "log.h5", {}),
    "packets": ("space_packet_parser", "a.dat", {"definition": "a.xml", "columns": "jpss"}),
    "ck": ("spiceypy", "a.bc", {}),
    "aem": ("ccsds_ndm", "a.aem", {}),
}


@pytest.mark.parametrize("name", MISSING)
def test_what_is_missing_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    module, file, options = MISSING[name]
    (tmp_path / file).write_text("CCSDS_AEM_VERS = 2.0\n")
    monkeypatch.setitem(sys.modules, module, None)
    extra = formats()[name].extra
    with pytest.raises(MissingDependencyError, match=rf"{module}.*celestcore\[{extra}\]"):
        open_log(tmp_path / file, format=name, **options)  # type: ignore[arg-type]
