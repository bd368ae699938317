"""Disks that are full, inputs that vanish or are cut: clear errors, and nothing half written."""

from __future__ import annotations

import contextlib
import io
import os
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from celestcore.errors import CelestcoreWarning, InputError, LogFormatError
from celestcore.formats import export, open_log
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

N = 20_000
T = 0.01 * np.arange(N)
RATE = np.random.default_rng(1).standard_normal((N, 3))
FILES = ("log", "log.npz", "log.csv", "log.h5")


def log() -> cc.SensorLog:
    position = (T[::100], np.tile([7e6, 0.0, 0.0], (N // 100, 1)))
    return cc.SensorLog(epoch="2026-01-01", gyro=(T, RATE), gnss=position)


def gyro_files(folder: Path, parts: int) -> list[Path]:
    (folder / "gyro").mkdir()
    files = []
    for k, rows in enumerate(np.array_split(np.arange(N), parts)):
        columns = dict(zip(("wx", "wy", "wz"), RATE[rows].T, strict=True))
        files.append(folder / "gyro" / f"part-{k}.parquet")
        pq.write_table(pa.table({"t": T[rows], **columns}), files[-1], write_page_checksum=True)
    return files


# ------------------------------------------------------------------ damage amid a file


def damage(path: Path, share: float) -> None:
    """Overwrite some bytes."""
    data = bytearray(path.read_bytes())
    place = int(share * len(data))
    data[place : place + 64] = bytes(64)
    path.write_bytes(data)


def before_the_fault(pieces: Any, words: str) -> list[Any]:
    """Return what comes before an error."""
    got: list[Any] = []
    with pytest.raises(LogFormatError, match=words):
        got.extend(pieces)
    return got


def test_parts_of_a_dataset_before_a_damaged_one_are_there(tmp_path: Path) -> None:
    damage(gyro_files(tmp_path, 4)[2], 0.5)
    stream = open_log(tmp_path, chunk_rows=1000)
    words = r"part-2.parquet: cannot be read as Parquet"
    rows = sum(len(columns["t"]) for _, columns in before_the_fault(stream, words))
    assert N // 2 <= rows < 3 * N // 4
    assert before_the_fault(stream.windows(10.0), words)[-1].stop >= 90.0
    kept = open_log(tmp_path, chunk_rows=1000, damaged="keep")
    with pytest.warns(CelestcoreWarning, match="kept what stands before the damage"):
        found = kept.read()
    assert found.gyro is not None
    assert len(found.gyro) == rows
    assert np.array_equal(found.gyro.rate, RATE[:rows])


def test_a_csv_cut_off_is_there_up_to_its_last_line(tmp_path: Path) -> None:
    cc.write_log(log(), tmp_path / "a.csv")
    data = (tmp_path / "a.csv").read_bytes()
    cut = data[: data.rindex(b",", 0, len(data) * 2 // 3)]
    (tmp_path / "a.csv").write_bytes(cut)
    lines = cut.count(b"\n") - 1
    with pytest.warns(CelestcoreWarning, match="cut off"):
        stream = open_log(tmp_path / "a.csv", damaged="keep", chunk_rows=500)
    with pytest.raises(LogFormatError, match="cells where"), pytest.warns(CelestcoreWarning):
        cc.read_log(tmp_path / "a.csv")
    with pytest.warns(CelestcoreWarning, match="kept what stands before"):
        rows = len(stream.read().gyro.t)  # type: ignore[union-attr]
    assert rows == lines


@pytest.mark.parametrize("name", ["log.npz", "log.h5"])
def test_damage_inside_an_array_is_found(name: str, tmp_path: Path) -> None:
    cc.write_log(log(), tmp_path / name)
    damage(tmp_path / name, 0.4)
    with pytest.raises(InputError):
        cc.read_log(tmp_path / name)


@pytest.mark.parametrize("share", [0.0, 0.01, 0.3, 0.9, 0.999])
@pytest.mark.parametrize("name", ["log.npz", "log.h5", "gyro.parquet"])
def test_truncated_files_are_named(name: str, share: float, tmp_path: Path) -> None:
    path = tmp_path / name
    if name == "gyro.parquet":
        gyro_files(tmp_path, 1)[0].rename(path)
    else:
        cc.write_log(log(), path)
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(LogFormatError, match=name) as caught:
        cc.read_log(path)
    assert "\n" not in str(caught.value)


# ------------------------------------------------------------------ input that goes away


def test_a_part_that_vanishes_is_named(tmp_path: Path) -> None:
    files = gyro_files(tmp_path, 3)
    stream = open_log(tmp_path, chunk_rows=1000)
    chunks = iter(stream)
    next(chunks)
    files[1].unlink()
    with pytest.raises(LogFormatError, match=r"part-1.parquet: the file has vanished"):
        list(chunks)


@pytest.mark.parametrize("name", FILES)
def test_a_log_that_vanishes_between_passes(name: str, tmp_path: Path) -> None:
    cc.write_log(log(), tmp_path / name)
    stream = open_log(tmp_path / name)
    (tmp_path / name).rename(tmp_path / "elsewhere")
    with pytest.raises(LogFormatError, match=r"vanished|No such file"):
        list(stream)


class Failing:
    """A file whose device stops after some bytes."""

    def __init__(self, path: Path, limit: int) -> None:
        self.stream, self.limit = path.open("rb"), limit
        self.read_bytes = 0

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)

    def __iter__(self) -> Iterator[bytes]:
        return iter(self.stream)

    def read(self, size: int = -1) -> bytes:
        data = self.stream.read(size)
        self.read_bytes += len(data)
        if self.read_bytes > self.limit:
            raise OSError(5, "Input/output error")
        return data

    def readinto(self, buffer: Any) -> int:
        data = self.read(len(buffer))
        buffer[: len(data)] = data
        return len(data)


@pytest.mark.parametrize("name", ["log.npz", "log.csv", "log.h5"])
def test_a_device_that_fails(name: str, tmp_path: Path) -> None:
    cc.write_log(log(), tmp_path / name)
    kind = {"h5": "hdf5"}.get(name[4:], name[4:])
    size = (tmp_path / name).stat().st_size
    file: Any = Failing(tmp_path / name, size // 2)
    try:
        with pytest.raises(LogFormatError):
            open_log(file, format=kind, chunk_rows=100).read()
    finally:
        file.stream.close()


# ------------------------------------------------------------------ a full disk

FULL = """
import resource, signal, sys
from pathlib import Path
import numpy as np
import celestcore as cc
from celestcore.formats import export

folder, name, limit = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
t = 0.5 * np.arange(4000)
q = np.tile([0.8, 0.6, 0.0, 0.0], (4000, 1))
rate = np.random.default_rng(1).standard_normal((4000, 3))
r = np.tile([7e6, 0.0, 0.0], (4000, 1))
log = cc.SensorLog(epoch="2026-01-01", star=(t, q), gyro=(t, rate), gnss=(t, r, r * 1e-3))
names = dict(object_name="SAT", object_id="2026-001A") if name[-2:] == "em" else {}
if limit:
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    export(log, folder / name, **names)
except cc.CelestcoreError as error:
    print(error)
"""


def write(folder: Path, name: str, limit: int) -> str:
    done = subprocess.run(
        [sys.executable, "-c", FULL, str(folder), name, str(limit)],
        check=True,
        capture_output=True,
        text=True,
    )
    return done.stdout


@pytest.mark.skipif(sys.platform == "win32", reason="needs limits of file sizes")
@pytest.mark.parametrize("name", [*FILES, "a.msopck", "a.aem", "a.oem"])
def test_what_was_there_stays_when_the_disk_is_full(name: str, tmp_path: Path) -> None:
    pytest.importorskip("ccsds_ndm")

    def content() -> dict[str, bytes]:
        return {
            str(f.relative_to(tmp_path)): f.read_bytes() for f in tmp_path.rglob("*") if f.is_file()
        }

    said = write(tmp_path, name, 16_384)
    assert "cannot be written" in said
    assert content() == {}
    assert write(tmp_path, name, 0) == ""
    before = content()
    assert before
    said = write(tmp_path, name, 16_384)
    assert "cannot be written" in said
    assert os.fspath(tmp_path / name) in said
    assert content() == before


# ------------------------------------------------------------------ anything at all

DATA = Path(__file__).resolve().parents[1] / "data"


def valid(kind: str, folder: Path) -> bytes:
    """Return a small file of a format."""
    t = np.arange(8.0)
    q = np.tile([0.8, 0.6, 0.0, 0.0], (8, 1))
    r = np.tile([7e6, 0.0, 0.0], (8, 1))
    if kind == "sentinel1":
        return (DATA / "sentinel1_annotation.xml").read_bytes()
    path = folder / f"a.{'h5' if kind == 'hdf5' else kind}"
    names = {"object_name": "SAT", "object_id": "2026-001A"} if kind in ("aem", "oem") else {}
    small = cc.SensorLog(epoch="2026-01-01", star=(t, q), gnss=(t, r, 1e-3 * r))
    export(small, path, **names)
    return path.read_bytes()


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("kind", ["npz", "csv", "hdf5", "aem", "oem", "sentinel1"])
@settings(deadline=None, max_examples=60, suppress_health_check=list(HealthCheck))
@given(
    edits=st.lists(
        st.tuples(st.floats(0.0, 1.0, exclude_max=True), st.binary(max_size=6)), max_size=4
    ),
    reorder=st.none() | st.floats(0.0, 10.0),
)
def test_a_file_edited_anywhere_is_read_or_an_error_of_the_family(
    kind: str,
    edits: list[tuple[float, bytes]],
    reorder: float | None,
    tmp_path_factory: pytest.TempPathFactory,
) -> None:
    if kind in ("aem", "oem"):
        pytest.importorskip("ccsds_ndm")
    if kind not in VALID:
        VALID[kind] = valid(kind, tmp_path_factory.mktemp(kind))
    data = bytearray(VALID[kind])
    for share, new in edits:
        place = int(share * len(data))
        data[place : place + len(new)] = new
    for damaged in ("raise", "keep"):
        with contextlib.suppress(cc.CelestcoreError):
            open_log(io.BytesIO(bytes(data)), format=kind, reorder=reorder, damaged=damaged).read()


VALID: dict[str, bytes] = {}


@pytest.mark.filterwarnings("ignore::celestcore.errors.CelestcoreWarning")
@pytest.mark.parametrize("kind", ["npz", "csv", "hdf5", "aem", "oem", "sentinel1", "parquet"])
@settings(deadline=None, max_examples=30)
@given(data=st.binary(max_size=300))
def test_bytes_that_are_no_log(kind: str, data: bytes) -> None:
    options = {"table": "gyro"} if kind == "parquet" else {}
    with pytest.raises(cc.CelestcoreError):
        open_log(io.BytesIO(data), format=kind, **options).read()  # type: ignore[arg-type]
