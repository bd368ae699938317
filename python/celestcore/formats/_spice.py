"""SPICE: C-kernels in, and out a table of quaternions for NAIF's program msopck."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._check import QUATERNION_HINT, FloatArray, quaternion, unit_rows
from celestcore._files import replacing
from celestcore._optional import require
from celestcore.ccsds._time import finite_rows, utc_strings
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._model import Chunk, Input, Lane, Source, first_line
from celestcore.frames._time import DAY, instant, tdb_minus_tt
from celestcore.quaternion import QuaternionLike, conjugate, continuous

J2000 = "2000-01-01T12:00:00 TT"
_WITH_RECORDS = (1, 3)
_STAR = ("t", "qw", "qx", "qy", "qz")
_GYRO = ("t", "wx", "wy", "wz")


def read(
    source: Input,
    *,
    kernels: Sequence[str | os.PathLike[str]] = (),
    instrument: int | None = None,
    frame: str = "J2000",
    period: float | None = None,
) -> Source:
    """Open a C-kernel.

    Parameters
    ----------
    source : Path
        The kernel; SPICE reads files only.
    kernels : sequence of path
        What it needs besides: the clock kernel (``.tsc``), usually leap seconds (``.tls``), and
        frames (``.tf``) where the segments' frame is not built in.
    instrument : int, optional
        The structure whose attitude is read; needed where the kernel holds several.
    frame : str
        The inertial frame of the result.
    period : float, optional
        Sample every so many seconds, within the kernel's coverage. Without it segments of type 1
        and 3 give the instances they hold; other types need it.
    """
    if not isinstance(source, Path):
        raise InputError("must be a path: SPICE reads no file objects", field="source")
    spice = require("spiceypy", extra="spice", what="reading SPICE kernels")
    kernels = [kernels] if isinstance(kernels, str | os.PathLike) else kernels  # one is a few
    with _loaded(spice, [source, *kernels]):
        objects = list(_try(lambda: spice.ckobj(str(source))))
        found = _chosen(objects, instrument)
        segments = _try(lambda: _segments(spice, str(source), found))
        has_rate = all(s["rates"] for s in segments)
        first = min(s["begin"] for s in segments)
        epoch, start = _whole_second(_elapsed(np.array([_et(spice, found, first)])))
    if period is None and any(s["type"] not in _WITH_RECORDS for s in segments):
        kinds = sorted({s["type"] for s in segments})
        raise InputError(f"is needed for segments of the types {kinds}", field="period")
    sensors = {"star": _STAR, **({"gyro": _GYRO} if has_rate else {})}

    def chunks(chunk_rows: int) -> Iterator[Chunk]:
        with _loaded(spice, [source, *kernels]):
            rows: list[Any] = []
            for row in _rows(spice, str(source), found, segments, frame, period):
                rows.append(row)
                if len(rows) >= chunk_rows:
                    yield _chunk(rows, start, has_rate)
                    rows = []
            if rows:
                yield _chunk(rows, start, has_rate)

    settings = {"log": {"epoch": epoch, "title": f"SPICE {found}"}, "frames": {"inertial": frame}}
    return Source((Lane(sensors, chunks),), settings)


def _try(action: Any) -> Any:
    try:
        return action()
    except InputError:
        raise
    except Exception as error:  # spiceypy has a class for every message of SPICE
        raise LogFormatError(f"SPICE cannot read it: {_said(error)}") from None


def _said(error: Exception) -> str:
    """Return what SPICE says, without the traceback of its own that it puts around."""
    lines = [getattr(error, "short", "") or first_line(error), getattr(error, "long", "") or ""]
    return " ".join(" ".join(lines).split())[:300]


@contextmanager
def _loaded(spice: Any, kernels: Sequence[str | os.PathLike[str]]) -> Iterator[None]:
    """Load kernels, and unload those again and no others."""
    with ExitStack() as stack:
        for kernel in kernels:
            name = os.fspath(kernel)
            if not os.path.isfile(name):
                raise LogFormatError("there is no such file", source=name)
            _try(lambda name=name: spice.furnsh(name))
            stack.callback(spice.unload, name)
        yield


def _chosen(objects: list[int], instrument: int | None) -> int:
    if instrument is None and len(objects) == 1:
        return int(objects[0])
    if instrument is None or instrument not in objects:
        known = ", ".join(str(int(o)) for o in objects)
        raise InputError(f"must be one of {known}", field="instrument", value=instrument)
    return int(instrument)


def _segments(spice: Any, kernel: str, instrument: int) -> list[dict[str, Any]]:
    """Return the descriptors of an instrument's segments."""
    handle = spice.dafopr(kernel)
    try:
        out = []
        spice.dafbfs(handle)
        while spice.daffna():
            packed = spice.dafgs(5)
            times, numbers = spice.dafus(packed, 2, 6)
            if int(numbers[0]) == instrument:
                out.append(
                    {
                        "packed": np.array(packed),
                        "begin": float(times[0]),
                        "end": float(times[1]),
                        "frame": int(numbers[1]),
                        "type": int(numbers[2]),
                        "rates": bool(numbers[3]),
                        "words": (int(numbers[4]), int(numbers[5])),
                    }
                )
    finally:
        spice.dafcls(handle)
    return sorted(out, key=lambda s: float(s["begin"]))


def _et(spice: Any, instrument: int, ticks: float) -> float:
    return float(_try(lambda: spice.sct2e(spice.ckmeta(instrument, "SCLK"), ticks)))


def _elapsed(et: FloatArray) -> FloatArray:
    """Return SI seconds since J2000 TT of ephemeris time (TDB since J2000)."""
    centuries = et / (36525.0 * DAY)
    return np.asarray(et - tdb_minus_tt(centuries))


def _whole_second(elapsed: FloatArray) -> tuple[str, float]:
    """Return the UTC second before a time, and its seconds since J2000 TT."""
    epoch = utc_strings(J2000, elapsed)[0].partition(".")[0]
    at, zero = instant(epoch), instant(J2000)
    return epoch, (at.mjd - zero.mjd) * DAY + (at.seconds - zero.seconds)


def _rows(
    spice: Any,
    kernel: str,
    instrument: int,
    segments: list[dict[str, Any]],
    frame: str,
    period: float | None,
) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Yield ephemeris time, the matrix from `frame` to the body, and the rate in `frame`."""
    if period is not None:
        yield from _sampled(spice, instrument, segments, frame, period)
        return
    handle = _try(lambda: spice.dafopr(kernel))
    try:
        for segment in segments:
            for ticks, q, rate in _instances(spice, handle, segment):
                et = _et(spice, instrument, ticks)
                base = spice.frmnam(segment["frame"])
                turn = (
                    np.eye(3)
                    if base == frame
                    else _try(lambda b=base, e=et: np.asarray(spice.pxform(frame, b, e)))
                )
                yield et, np.asarray(spice.q2m(q)) @ turn, turn.T @ rate
    finally:
        spice.dafcls(handle)


def _turn(spice: Any, frame: str, base: str, et: float) -> FloatArray:
    return np.asarray(_try(lambda: spice.pxform(frame, base, et)))


def _instances(
    spice: Any, handle: int, segment: dict[str, Any]
) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Yield clock, quaternion and rate (NaN without) of a segment of type 1 or 3."""
    packed, no_rate = segment["packed"], np.full(3, np.nan)
    if segment["type"] == 3:
        for k in range(1, int(_try(lambda: spice.cknr03(handle, packed))) + 1):
            record = np.asarray(_try(lambda k=k: spice.ckgr03(handle, packed, k)))
            yield float(record[0]), record[1:5], record[5:8] if segment["rates"] else no_rate
        return
    first, last = segment["words"]  # records, their clocks, every hundredth of these, their number
    count = int(_try(lambda: spice.dafgda(handle, last, last))[0])
    width = 7 if segment["rates"] else 4
    clocks = first + count * width
    for k in range(count):
        at = first + k * width
        record = np.asarray(_try(lambda at=at: spice.dafgda(handle, at, at + width - 1)))
        ticks = float(_try(lambda k=k: spice.dafgda(handle, clocks + k, clocks + k))[0])
        yield ticks, record[:4], record[4:] if segment["rates"] else no_rate


def _sampled(
    spice: Any, instrument: int, segments: list[dict[str, Any]], frame: str, period: float
) -> Iterator[tuple[float, FloatArray, FloatArray]]:
    """Sample a kernel regularly; instants at which it has no attitude are left out."""
    clock, has_rate = spice.ckmeta(instrument, "SCLK"), all(s["rates"] for s in segments)
    begin = _et(spice, instrument, segments[0]["begin"])
    end = _et(spice, instrument, max(s["end"] for s in segments))
    for k in range(int((end - begin) / period) + 1):
        et = begin + k * period
        ticks = _try(lambda et=et: spice.sce2c(clock, et))
        try:
            if has_rate:
                matrix, rate, _ = spice.ckgpav(instrument, ticks, 0.0, frame)
            else:
                (matrix, _), rate = spice.ckgp(instrument, ticks, 0.0, frame), np.full(3, np.nan)
        except spice.NotFoundError:
            continue
        except Exception as error:
            raise LogFormatError(f"SPICE cannot read it: {_said(error)}") from None
        yield et, np.asarray(matrix), np.asarray(rate)


def _chunk(rows: list[Any], start: float, has_rate: bool) -> Chunk:
    """Return rows as columns: body to inertial, rates in the body."""
    et = np.array([row[0] for row in rows])
    c_bi = np.array([row[1] for row in rows])
    t = _elapsed(et) - start
    q = continuous(_quaternions(np.swapaxes(c_bi, 1, 2)))
    chunk = {"star": {"t": t, **dict(zip(_STAR[1:], q.T, strict=True))}}
    if has_rate:
        rate = np.einsum("nij,nj->ni", c_bi, np.array([row[2] for row in rows]))
        chunk["gyro"] = {"t": t, **dict(zip(_GYRO[1:], rate.T, strict=True))}
    return chunk


def _quaternions(matrix: FloatArray) -> FloatArray:
    from celestcore.quaternion import from_matrix

    return np.asarray(from_matrix(matrix))


def write_msopck(path: str | os.PathLike[str], epoch: Any, t: Any, q_ib: QuaternionLike) -> None:
    """Write the table of quaternions that NAIF's program msopck makes a C-kernel of.

    A line holds a UTC time and SPICE's quaternion, scalar first: that of the matrix from inertial
    to body components. In the program's setup say ``INPUT_DATA_TYPE = 'SPICE QUATERNIONS'``,
    ``INPUT_TIME_TYPE = 'UTC'`` and ``ANGULAR_RATE_PRESENT = 'MAKE UP'``.

    Parameters
    ----------
    path : path
        The file, replaced when complete.
    epoch : str, datetime or astropy Time
        Where times count from.
    t : array_like (n,)
        Elapsed SI seconds since the epoch, increasing.
    q_ib : array_like (n, 4) or Rotation
        Body to inertial, scalar first.

    Raises
    ------
    InputError
        Names the row that cannot be written.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "mine.msopck"
    >>> write_msopck(path, "2026-01-01", [0.0], [[0.8, 0.6, 0.0, 0.0]])
    >>> line = path.read_text().split()
    >>> line[0], [float(x) for x in line[1:]]
    ('2026-01-01T00:00:00.000', [0.8, -0.6, 0.0, 0.0])
    """
    texts = utc_strings(epoch, t)
    q = finite_rows(quaternion(q_ib, "q_ib"), "q_ib", len(texts), 4)
    q = conjugate(continuous(unit_rows(q, "q_ib", what="quaternion", hint=QUATERNION_HINT)))
    with replacing(path) as temporary, temporary.open("w", encoding="ascii", newline="\n") as file:
        for text, row in zip(texts, (q + 0.0).tolist(), strict=True):
            file.write(f"{text} " + " ".join(f"{x:.16e}" for x in row) + "\n")
