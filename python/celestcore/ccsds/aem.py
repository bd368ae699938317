"""Attitude Ephemeris Messages (CCSDS 504.0-B-2)."""

from __future__ import annotations

import os
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import QUATERNION_HINT, FloatArray, array, quaternion, unit_rows
from celestcore.ccsds._file import Loaded, created, library, save, words
from celestcore.ccsds._time import finite_rows, increasing, utc_strings
from celestcore.errors import InputError, LogFormatError
from celestcore.quaternion import QuaternionLike, conjugate, continuous


@dataclass(frozen=True)
class AttitudeMessage:
    """One segment of an Attitude Ephemeris Message.

    Attributes
    ----------
    epoch : str
        Time of the first row, UTC unless a scale follows.
    t : ndarray (n,)
        Elapsed SI seconds since `epoch`.
    q : ndarray (n, 4)
        Unit quaternions, scalar first, `body` to `frame`: ``q_ib`` if `frame` is inertial.
        Sign-continuous.
    frame, body : str
        The outer frame (``GCRF``, ...) and the one of the spacecraft (``SC_BODY_1``).
    object_name, object_id, originator : str
        What the message says of itself.

    Examples
    --------
    >>> AttitudeMessage.__dataclass_fields__["body"].type
    'str'
    """

    epoch: str
    t: FloatArray
    q: FloatArray
    frame: str
    body: str
    object_name: str
    object_id: str
    originator: str


def write_aem(
    path: str | os.PathLike[str],
    epoch: Any,
    t: ArrayLike,
    q_ib: QuaternionLike,
    *,
    object_name: str,
    object_id: str,
    frame: str = "GCRF",
    body: str = "SC_BODY_1",
    originator: str = "celestcore",
    creation_date: str | None = None,
) -> None:
    """Write an attitude as an Attitude Ephemeris Message of version 2, quaternions.

    CCSDS says that Q1, Q2, Q3, QC (the scalar last, in version 2 always) "represent the coordinate
    transformation from frame A to frame B", with Q1 to Q3 the axis times ``sin(phi/2)``. That
    transformation's quaternion is the Hamilton quaternion that takes ``B`` components to ``A``
    components: with REF_FRAME_A = `frame` and REF_FRAME_B = `body` it is ``q_ib`` as it stands,
    nothing conjugated, only the scalar moved to the end.

    Parameters
    ----------
    path, epoch, t, object_name, object_id, originator, creation_date
        As in `write_oem`.
    q_ib : array_like (n, 4) or scipy Rotation
        Unit quaternions, `body` to `frame`. Their signs are made continuous.
    frame : str
        The frame that attitudes are relative to, REF_FRAME_A: ``"GCRF"`` is the GCRS.
    body : str
        The frame of the spacecraft, REF_FRAME_B.

    Raises
    ------
    InputError
        Names the field and row that cannot be written: not finite, not of unit length, a time
        that does not increase.
    MissingDependencyError
        If the package `ccsds-ndm-py` is not installed.

    Examples
    --------
    >>> import tempfile, pathlib
    >>> path = pathlib.Path(tempfile.mkdtemp()) / "attitude.aem"
    >>> write_aem(path, "2026-01-01", [0.0], [[0.8, 0.6, 0.0, 0.0]], object_name="SAT",
    ...           object_id="2026-001A")
    >>> line = path.read_text().splitlines()[-2]
    >>> line.split()[0], [float(x) for x in line.split()[1:]]
    ('2026-01-01T00:00:00.000', [0.6, 0.0, 0.0, 0.8])
    """
    names = words(
        object_name=object_name, object_id=object_id, frame=frame, body=body, originator=originator
    )
    ndm, times = library(), utc_strings(epoch, t)
    q = finite_rows(quaternion(q_ib, "q_ib"), "q_ib", len(times), 4)
    q = continuous(unit_rows(q, "q_ib", what="quaternion", hint=QUATERNION_HINT))
    meta = ndm.AemMetadata(
        names["object_name"],
        names["object_id"],
        ref_frame_a=names["frame"],
        ref_frame_b=names["body"],
        start_time=times[0],
        stop_time=times[-1],
        time_system="UTC",
        attitude_type="QUATERNION",
    )
    header = ndm.AdmHeader(created(creation_date), names["originator"])
    last = np.ascontiguousarray(np.clip(np.roll(q, -1, axis=1), -1.0, 1.0))
    data = ndm.AemData.from_numpy(times, last, attitude_type="QUATERNION")
    save(path, ndm.Aem(header, [ndm.AemSegment(meta, data)]))


def read_aem(path: str | os.PathLike[str], *, segment: int | None = None) -> AttitudeMessage:
    """Read an attitude from an Attitude Ephemeris Message, KVN or XML.

    Version 2 is read, and version 1 with its keywords ATTITUDE_DIR (``B2A`` is turned round) and
    QUATERNION_TYPE (scalar first or last). Where the message goes from the spacecraft outward
    (REF_FRAME_A begins with ``SC_``) it is turned round too, so that `q` always takes body
    components outward. Of rates and derivatives beside the quaternion nothing is kept.

    Parameters
    ----------
    path, segment
        As in `read_oem`.

    Returns
    -------
    AttitudeMessage
        Quaternions scalar first, elapsed seconds.

    Raises
    ------
    LogFormatError, InputError, MissingDependencyError
        As in `read_oem`; also if the attitude is not given as quaternions.

    Examples
    --------
    >>> read_aem("not_there.aem")
    Traceback (most recent call last):
    ...
    celestcore.errors.LogFormatError: not_there.aem: cannot be read (No such file or directory)
    """
    loaded = Loaded(path, "AEM")
    number, part = loaded.pick(segment)
    meta, data = part.metadata, part.data
    kind = meta.attitude_type
    if not kind.startswith("QUATERNION"):
        raise LogFormatError(
            "only quaternions are read", field="ATTITUDE_TYPE", value=kind, source=loaded.name
        )
    try:
        epoch, t = increasing(data.attitude_states_epochs, meta.time_system.upper(), "aem")
        q = array(np.asarray(data.attitude_states_numpy)[:, :4], "aem.quaternion")
        if loaded.keyword("scalar", number, ("FIRST", "LAST")) == "LAST":
            q = np.roll(q, 1, axis=1)
        q = continuous(unit_rows(q, "aem.quaternion", what="quaternion", hint="is it damaged?"))
    except InputError as error:
        raise error.located(loaded.name) from None
    frame, body = meta.ref_frame_a, meta.ref_frame_b
    if loaded.keyword("direction", number, ("B2A", "A2B")) == "B2A":
        q = conjugate(q)
    if frame.upper().startswith("SC_") and not body.upper().startswith("SC_"):
        q, frame, body = conjugate(q), body, frame
    return AttitudeMessage(
        epoch=epoch,
        t=t,
        q=q,
        frame=frame,
        body=body,
        object_name=meta.object_name,
        object_id=meta.object_id,
        originator=loaded.message.header.originator,
    )
