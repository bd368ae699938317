"""Orbit Ephemeris Messages (CCSDS 502.0-B-3)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import FloatArray, array
from celestcore.ccsds._file import Loaded, created, library, save, words
from celestcore.ccsds._time import finite_rows, increasing, since, utc_strings
from celestcore.errors import InputError

KILO = 1e3
_EARTH = 6.3e6


@dataclass(frozen=True)
class OrbitMessage:
    """One segment of an Orbit Ephemeris Message.

    Attributes
    ----------
    epoch : str
        Time of the first row, UTC unless a scale follows.
    t : ndarray (n,)
        Elapsed SI seconds since `epoch`.
    r, v : ndarray (n, 3)
        Positions [m] and velocities [m/s] in `frame`.
    covariance : ndarray (k, 6, 6) or None
        Of position and velocity [m^2, m^2/s, m^2/s^2].
    covariance_t : ndarray (k,) or None
        Its times [s].
    covariance_frame : str or None
        Its axes; a message without this keyword means `frame`.
    frame, center : str
        Reference frame (``GCRF``, ``ITRF``, ``EME2000``, ...) and its origin, as the message has
        it.
    object_name, object_id, originator : str
        What the message says of itself.

    Examples
    --------
    >>> OrbitMessage.__dataclass_fields__["frame"].type
    'str'
    """

    epoch: str
    t: FloatArray
    r: FloatArray
    v: FloatArray
    covariance: FloatArray | None
    covariance_t: FloatArray | None
    covariance_frame: str | None
    frame: str
    center: str
    object_name: str
    object_id: str
    originator: str


def write_oem(
    path: str | os.PathLike[str],
    epoch: Any,
    t: ArrayLike,
    r: ArrayLike,
    v: ArrayLike,
    *,
    object_name: str,
    object_id: str,
    covariance: ArrayLike | None = None,
    frame: str = "GCRF",
    originator: str = "celestcore",
    creation_date: str | None = None,
) -> None:
    """Write an orbit as an Orbit Ephemeris Message of version 3.

    Parameters
    ----------
    path : path
        The file; XML if its name ends in ``.xml``, otherwise KVN. It is replaced when complete.
    epoch : str, datetime or astropy Time
        Start of the time line; UTC unless a scale follows. The message is in UTC.
    t : array_like (n,)
        Elapsed SI seconds since the epoch, increasing; kept to the nanosecond.
    r, v : array_like (n, 3)
        Positions [m] and velocities [m/s] in `frame`, from the Earth's centre.
    object_name, object_id : str
        Name and international designator (``"2026-001A"``).
    covariance : array_like (n, 6, 6), optional
        Of position and velocity [m^2, m^2/s, m^2/s^2], axes of `frame`, one to each row.
    frame : str
        ``"GCRF"`` (the GCRS of `celestcore.frames`), ``"ITRF"`` (with velocities relative to the
        turning Earth), or another name of CCSDS.
    originator, creation_date : str, optional
        Who made it, and when (UTC, now unless given).

    Raises
    ------
    InputError
        Names the field and row that cannot be written: not finite, inside the Earth (kilometres
        for metres), a time that does not increase, a covariance not symmetric.
    MissingDependencyError
        If the package `ccsds-ndm-py` is not installed.

    Examples
    --------
    >>> write_oem("x.oem", "2026-01-01", [0.0], [[7e3, 0.0, 0.0]], [[0.0, 7.5, 0.0]],
    ...           object_name="SAT", object_id="2026-001A")
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: r, row 0, value (7000.0, 0.0, 0.0): is inside the Earth...
    """
    names = words(object_name=object_name, object_id=object_id, frame=frame, originator=originator)
    ndm, times = library(), utc_strings(epoch, t)
    n = len(times)
    states = np.hstack([finite_rows(r, "r", n), finite_rows(v, "v", n)])
    inside = np.linalg.norm(states[:, :3], axis=1) < _EARTH
    if inside.any():
        row = int(np.argmax(inside))
        raise InputError(
            "is inside the Earth: give metres from its centre",
            field="r",
            row=row,
            value=states[row, :3],
        )
    c = None if covariance is None else _covariance(covariance, n) / KILO**2
    given = () if c is None else (times, c)
    meta = ndm.OemMetadata(
        names["object_name"],
        names["object_id"],
        times[0],
        times[-1],
        center_name="EARTH",
        ref_frame=names["frame"],
        time_system="UTC",
    )
    header = ndm.OdmHeader(created(creation_date), names["originator"])
    data = ndm.OemData.from_numpy(times, states / KILO, *given)
    save(path, ndm.Oem(header, [ndm.OemSegment(meta, data)]))


def read_oem(path: str | os.PathLike[str], *, segment: int | None = None) -> OrbitMessage:
    """Read an orbit from an Orbit Ephemeris Message, KVN or XML.

    Parameters
    ----------
    path : path
        The file.
    segment : int, optional
        Which segment, from 0; needed where there are several, as before and after a manoeuvre.

    Returns
    -------
    OrbitMessage
        In m, m/s and elapsed seconds. The frame is named, not converted.

    Raises
    ------
    LogFormatError
        If the file is missing, no OEM, or has several segments and none was chosen. Names the line
        that cannot be read.
    InputError
        If a time cannot be read or does not increase: names the row.
    MissingDependencyError
        If the package `ccsds-ndm-py` is not installed.

    Examples
    --------
    >>> read_oem("not_there.oem")
    Traceback (most recent call last):
    ...
    celestcore.errors.LogFormatError: not_there.oem: cannot be read (No such file or directory)
    """
    loaded = Loaded(path, "OEM")
    _, part = loaded.pick(segment)
    meta, data = part.metadata, part.data
    system = meta.time_system.upper()
    try:
        epoch, t = increasing(data.state_vector_epochs, system, "oem")
        covariance, when, axes = _read_covariance(data, epoch, system)
    except InputError as error:
        raise error.located(loaded.name) from None
    states = KILO * np.asarray(data.state_vector_numpy, dtype=np.float64)
    return OrbitMessage(
        epoch=epoch,
        t=t,
        r=np.ascontiguousarray(states[:, :3]),
        v=np.ascontiguousarray(states[:, 3:6]),
        covariance=covariance,
        covariance_t=when,
        covariance_frame=axes or (None if covariance is None else meta.ref_frame),
        frame=meta.ref_frame,
        center=meta.center_name,
        object_name=meta.object_name,
        object_id=meta.object_id,
        originator=loaded.message.header.originator,
    )


def _covariance(value: ArrayLike, n: int) -> FloatArray:
    c = array(value, "covariance", (n, 6, 6))
    turned = np.swapaxes(c, 1, 2)
    scale = np.sqrt(np.abs(np.diagonal(c, axis1=1, axis2=2)))
    off = np.abs(c - turned) > 1e-8 * scale[:, :, None] * scale[:, None, :]
    bad = off.any(axis=(1, 2)) | ~np.isfinite(c).all(axis=(1, 2))
    bad |= (np.diagonal(c, axis1=1, axis2=2) < 0.0).any(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "must be finite and symmetric, its variances not negative",
            field="covariance",
            row=row,
        )
    return np.ascontiguousarray(0.5 * (c + turned))


def _read_covariance(
    data: Any, epoch: str, system: str
) -> tuple[FloatArray | None, FloatArray | None, str | None]:
    """Return the covariances [SI], their times and their common axes."""
    matrices = list(data.covariance_matrix)
    if not matrices:
        return None, None, None
    axes = {m.cov_ref_frame for m in matrices}
    if len(axes) > 1:
        listed = ", ".join(sorted(str(a) for a in axes))
        raise InputError(f"has different axes: {listed}", field="COV_REF_FRAME")
    when = since(epoch, data.covariance_matrix_epochs, system, "oem.covariance")
    values = np.asarray(data.covariance_matrix_numpy, dtype=np.float64)
    return KILO**2 * values, when, axes.pop()
