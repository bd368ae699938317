"""Broken files: truncated, damaged, empty, columns missing; all are errors of one family."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from celestcore.errors import CelestcoreError, CelestcoreWarning, InputError, LogFormatError
from celestcore.io import read_log, write_log
from celestcore.log import SensorLog
from hypothesis import given, settings
from hypothesis import strategies as st

NAMES = ("log", "log.npz", "log.csv")
T = np.arange(8.0)
RATE = np.random.default_rng(1).standard_normal((8, 3)) * 1e-3
Q = np.random.default_rng(2).standard_normal((8, 4))
Q /= np.linalg.norm(Q, axis=1)[:, None]


def simple() -> SensorLog:
    return SensorLog(gyro=(T, RATE), star=(T[::2], Q[::2]))


def csv_file(text: str | bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        data = text.encode() if isinstance(text, str) else text
        (folder / "a.csv").write_bytes(data)
        return folder / "a.csv"

    return make


def npz_file(**arrays: Any) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        np.savez(folder / "a.npz", **arrays)
        return folder / "a.npz"

    return make


def raw_file(name: str, data: bytes) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        (folder / name).parent.mkdir(exist_ok=True)
        (folder / name).write_bytes(data)
        return folder / name

    return make


def parquet_dir(name: str, **columns: Any) -> Callable[[Path], Path]:
    def make(folder: Path) -> Path:
        pq.write_table(pa.table(columns), folder / f"{name}.parquet")
        return folder

    return make


def parent(make: Callable[[Path], Path]) -> Callable[[Path], Path]:
    return lambda folder: make(folder).parent


GYRO: dict[str, Any] = {"t": [0.0, 1.0], "wx": [0.0, 0.0], "wy": [0.0, 0.0], "wz": [0.0, 0.0]}
NPZ_GYRO = {f"gyro_{k}": v for k, v in GYRO.items()}
STAR = {"t": [0.0], "qw": [1.0], "qx": [0.0], "qy": [0.0], "qz": [0.0]}
HEAD = "t,wx,wy,wz\n"

FAULTS: dict[str, tuple[Callable[[Path], Path], type[InputError], list[str]]] = {
    "no file": (lambda d: d / "a.npz", LogFormatError, ["no such file"]),
    "no directory": (lambda d: d / "missing", LogFormatError, ["no such file"]),
    "other ending": (raw_file("a.txt", b"1"), LogFormatError, ["known are NAME.npz"]),
    "no ending": (raw_file("log", b"1"), LogFormatError, ["known are NAME.npz"]),
    "single parquet": (raw_file("mine.parquet", b"1"), LogFormatError, ["give the directory"]),
    "damaged parquet": (raw_file("gyro.parquet", b"1"), LogFormatError, ["cannot be read"]),
    # npz
    "empty npz": (raw_file("a.npz", b""), LogFormatError, ["cannot be read as NPZ"]),
    "text npz": (raw_file("a.npz", b"t,wx"), LogFormatError, ["no NPZ file"]),
    "pickle": (raw_file("a.npz", b"\x80\x04N."), LogFormatError, ["no NPZ file"]),
    "npy": (
        raw_file(
            "a.npz",
            b"\x93NUMPY\x01\x00F\x00"
            + b"{'descr': '<f8', 'fortran_order': False, 'shape': (1,)}".ljust(69)
            + b"\n"
            + bytes(8),
        ),
        LogFormatError,
        ["bare array"],
    ),
    "objects": (
        npz_file(**{**NPZ_GYRO, "gyro_wx": np.array([None, 1], dtype=object)}),
        LogFormatError,
        ["Python objects"],
    ),
    "npz without tables": (npz_file(a=[1], t=[2]), LogFormatError, ["found: a, t", "gyro_t"]),
    "npz without keys": (npz_file(), LogFormatError, ["found: nothing"]),
    "npz column": (
        npz_file(gyro_t=[0], gyro_wx=[0], gyro_wz=[0]),
        LogFormatError,
        ["gyro: column wy missing", "found: gyro_t, gyro_wx, gyro_wz"],
    ),
    "npz without time": (npz_file(gyro_wx=[0]), LogFormatError, ["columns t, wy, wz missing"]),
    "npz part of sigma": (
        npz_file(**{f"star_{k}": v for k, v in STAR.items()}, star_sx=[1e-5]),
        LogFormatError,
        ["columns sy, sz missing"],
    ),
    "npz lengths": (npz_file(**{**NPZ_GYRO, "gyro_wy": [0.0]}), InputError, ["gyro.wy", "1 rows"]),
    "npz matrix": (
        npz_file(**{**NPZ_GYRO, "gyro_wy": np.eye(2)}),
        InputError,
        ["gyro.wy", "(2, 2)"],
    ),
    "npz text": (npz_file(**{**NPZ_GYRO, "gyro_wy": ["a", "b"]}), InputError, ["gyro.wy", "'a'"]),
    "npz time": (
        npz_file(**{**NPZ_GYRO, "gyro_t": [1.0, 1.0]}),
        InputError,
        ["gyro.t, row 1, value 1.0", "repeats"],
    ),
    # parquet
    "empty directory": (lambda d: d, LogFormatError, ["no .parquet files", "found: nothing"]),
    "directory of others": (parent(raw_file("x.txt", b"")), LogFormatError, ["found: x.txt"]),
    "empty parquet": (parent(raw_file("gyro.parquet", b"")), LogFormatError, ["gyro.parquet"]),
    "text parquet": (parent(raw_file("gyro.parquet", b"t,wx" * 9)), LogFormatError, ["truncated"]),
    "parquet column": (
        parquet_dir("gyro", t=[0.0], wx=[0.0], extra=[0.0]),
        LogFormatError,
        ["gyro.parquet", "columns wy, wz missing", "found: t, wx, extra"],
    ),
    "parquet table": (parquet_dir("gyros", **GYRO), LogFormatError, ["gyros", "known are gyro"]),
    "parquet text": (
        parquet_dir("gyro", **{**GYRO, "wx": ["a", "b"]}),
        LogFormatError,
        ["gyro.wx", "string"],
    ),
    "parquet dates": (
        parquet_dir("gyro", **{**GYRO, "wx": np.array([0, 1], dtype="M8[s]")}),
        LogFormatError,
        ["gyro.wx", "timestamp"],
    ),
    "parquet nested": (
        parquet_dir("gyro", **{**GYRO, "wx": [[0.0], [1.0]]}),
        LogFormatError,
        ["gyro.wx", "list"],
    ),
    "parquet null time": (
        parquet_dir("gyro", **{**GYRO, "t": [0.0, None]}),
        InputError,
        ["gyro.t, row 1", "finite"],
    ),
    "parquet without rows": (
        parquet_dir("gyro", **{k: pa.array([], pa.float64()) for k in GYRO}),
        InputError,
        ["gyro.t", "empty"],
    ),
    "both noises": (
        parquet_dir(
            "star",
            **{
                k: STAR.get(k, [1e-5])
                for k in (*STAR, "sx", "sy", "sz", "cxx", "cxy", "cxz", "cyy", "cyz", "czz")
            },
        ),
        LogFormatError,
        ["sx... and cxx..."],
    ),
    # csv
    "empty csv": (csv_file(""), LogFormatError, ["is empty"]),
    "blank csv": (csv_file("\n\n"), LogFormatError, ["no header"]),
    "header only": (csv_file(HEAD), LogFormatError, ["no rows"]),
    "binary csv": (csv_file(bytes(range(128, 256)) + b"\n"), LogFormatError, ["UTF-8"]),
    "csv of old Macs": (csv_file("t,wx,wy,wz\r0,0,0,0\r"), LogFormatError, ["no header line"]),
    "csv column": (csv_file("t,wx,wz\n0,0,0\n"), LogFormatError, ["wy missing; found: t, wx, wz"]),
    "csv without time": (csv_file("wx,wy,wz\n0,0,0\n"), LogFormatError, ["column t missing"]),
    "csv others": (csv_file("a,b\n0,0\n"), LogFormatError, ["no columns of a log", "found: a, b"]),
    "csv twice": (
        csv_file("t,wx,wy,wz,wx\n0,0,0,0,0\n"),
        LogFormatError,
        ["several columns", "wx"],
    ),
    "csv both forms": (csv_file("t,wx,gyro_wx\n0,0,0\n"), LogFormatError, ["given twice"]),
    "csv own time": (csv_file("t,wx,wy,wz,star_t\n0,0,0,0,0\n"), LogFormatError, ["share the one"]),
    "csv text": (
        csv_file(HEAD + "0,0,0,0\n1,0,abc,0\n"),
        LogFormatError,
        ["wy, row 1, value 'abc'", "no number"],
    ),
    "csv cut off": (
        csv_file(HEAD + "0,0,0,0\n1,0,0,0\n2,0\n"),
        LogFormatError,
        ["row 2", "2 cells where 4", "cut off"],
    ),
    "csv all blank": (csv_file(HEAD + "0,,,\n1,,,\n"), LogFormatError, ["blank"]),
    "csv blank time": (csv_file(HEAD + "0,0,0,0\n,0,0,0\n"), InputError, ["gyro.t, row 1"]),
    "csv row of the file": (
        csv_file("t,qw,qx,qy,qz\n0,1,0,0,0\n1,,,,\n2,,,,\n3,2,0,0,0\n"),
        InputError,
        ["star.q, row 3, value (2.0, 0.0, 0.0, 0.0)"],
    ),
    "csv sigma": (
        csv_file("t,qw,qx,qy,qz,sx,sy,sz\n0,1,0,0,0,1,1,1\n1,1,0,0,0,1,,1\n"),
        InputError,
        ["star.sigma, row 1"],
    ),
}


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("name", FAULTS)
def test_broken_files_are_named(name: str, tmp_path: Path) -> None:
    make, cls, parts = FAULTS[name]
    path = make(tmp_path)
    with pytest.raises(CelestcoreError) as caught:
        read_log(path)
    assert type(caught.value) is cls
    text = str(caught.value)
    assert text.startswith(str(path))
    assert "\n" not in text
    for part in parts:
        assert part in text


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("name", NAMES)
@settings(deadline=None, max_examples=60)
@given(share=st.floats(0.0, 1.0, exclude_max=True))
def test_a_file_cut_anywhere_is_an_error_of_the_family(name: str, share: float) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        log = simple()
        write_log(log, path)
        file = path / "star.parquet" if name == "log" else path
        data = file.read_bytes()
        file.write_bytes(data[: int(share * len(data))])
        if name != "log.csv":
            with pytest.raises(LogFormatError):
                read_log(path)
            return
        try:  # whole lines of a CSV may be lost without a trace, but nothing else
            again = read_log(path)
        except InputError:
            return
        assert again.span[1] <= log.span[1]


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("name", ["log.npz", "log"])
@settings(deadline=None, max_examples=100)
@given(where=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_harmless_or_an_error_of_the_family(
    name: str, where: float, bit: int
) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        write_log(simple(), path)
        file = path / "gyro.parquet" if name == "log" else path
        data = bytearray(file.read_bytes())
        data[int(where * len(data))] ^= 1 << bit
        file.write_bytes(data)
        try:
            again = read_log(path)
        except InputError:
            return
        for table, whole in simple().tables.items():  # a damaged index may lose a whole table
            if table in again.tables:
                assert all(map(np.array_equal, whole._parts(), again.tables[table]._parts()))


def test_a_csv_whose_last_line_has_no_end_warns(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text("t,wx,wy,wz\n0,0,0,0\n1,0,0,0.12")
    with pytest.warns(CelestcoreWarning, match="cut off"):
        assert len(read_log(tmp_path / "a.csv")) == 2


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize(
    ("text", "parts"),
    [
        ("[gyro]\narv = 1", ["gyro.arv", "known are arw"]),
        ("[gyro\n", ["not valid TOML"]),
        ("\udcff", ["not valid TOML"]),
        ("[log]\nepoch = 'soon'", ["epoch", "'soon'"]),
    ],
)
def test_broken_sidecars_are_named(name: str, text: str, parts: list[str], tmp_path: Path) -> None:
    write_log(simple(), tmp_path / name)
    sidecar = tmp_path / ("log/log.toml" if name == "log" else "log.toml")
    sidecar.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError) as caught:
        read_log(tmp_path / name)
    assert str(caught.value).startswith(str(sidecar))
    for part in parts:
        assert part in str(caught.value)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
def test_a_file_without_permission(tmp_path: Path) -> None:
    write_log(simple(), tmp_path / "a.npz")
    (tmp_path / "a.npz").chmod(0)
    with pytest.raises(LogFormatError):
        read_log(tmp_path / "a.npz")
