"""Sentinel-1 product annotation: orbit state vectors, attitude quaternions and body rates.

The frame of the quaternions is not written down in the annotation. Found from five products of
Sentinel-1A and 1B, ascending and descending: with

    q_ib = (q0, -q3, -q2, q1) * (90 degrees about z)

the annotated body rates are those of the quaternions, x points along-track, y right and z down, and
the roll is the mission's law, 30 degrees right of the nadir, with the yaw of zero Doppler.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any
from xml.etree import ElementTree

import numpy as np

from celestcore._check import FloatArray
from celestcore.ccsds._time import elapsed
from celestcore.errors import LogFormatError
from celestcore.formats._ccsds import whole
from celestcore.formats._model import Columns, Input, Source, first_line, opened
from celestcore.quaternion import continuous, multiply

_QUARTER = np.array([np.sqrt(0.5), 0.0, 0.0, np.sqrt(0.5)])


def read(source: Input) -> Source:
    """Open an annotation: ``gnss`` from the orbit, ``star`` and ``gyro`` from the attitude.

    These are the products of the ground's and the satellite's filters, not raw measurements.

    Parameters
    ----------
    source : Path or binary file
        The XML file of one swath and polarisation.
    """
    orbit, attitude, mission = _elements(source)
    if not orbit and not attitude:
        raise LogFormatError("has neither an orbitList nor an attitudeList")
    texts = [row.pop("time") for row in (*orbit, *attitude)]
    epoch = min(texts).partition(".")[0]
    t = elapsed([epoch, *texts], "UTC", "time")[1][1:]
    tables: dict[str, Columns] = {}
    if attitude:
        when = t[len(orbit) :]
        q = multiply(_take(attitude, "q0 -q3 -q2 q1"), _QUARTER)
        tables["gyro"] = {"t": when, **_columns("wx wy wz", _take(attitude, "wx wy wz"))}
        tables["star"] = {"t": when, **_columns("qw qx qy qz", continuous(q))}
    if orbit:
        names = "x y z vx vy vz"
        tables["gnss"] = {"t": t[: len(orbit)], **_columns(names, _take(orbit, names))}
    frames = {"inertial": "EME2000", "body": "x along-track, y right, z down at zero roll"}
    return whole(tables, epoch, f"Sentinel-1 {mission}", {**frames, "earth": "ITRF"})


def _elements(source: Input) -> tuple[list[dict[str, Any]], list[dict[str, Any]], str]:
    """Return the fields of each orbit and attitude record, and the mission's name."""
    orbit: list[dict[str, Any]] = []
    attitude: list[dict[str, Any]] = []
    mission = ""
    try:
        for element in _finished(source):
            if element.tag == "missionId":
                mission = mission or (element.text or "")
            elif element.tag == "attitude":
                attitude.append(_fields(element))
            elif element.tag == "orbit" and element.find("position") is not None:
                orbit.append(_fields(element))
            else:
                continue
            element.clear()
    except ElementTree.ParseError as error:
        raise LogFormatError(f"is no complete XML file ({first_line(error)})") from None
    return orbit, attitude, mission


def _finished(source: Input) -> Iterator[Any]:
    with opened(source) as stream:
        for _, element in ElementTree.iterparse(stream, events=("end",)):
            yield element


def _fields(element: Any) -> dict[str, Any]:
    """Return the texts of a record by name; a velocity's are vx, vy, vz."""
    out: dict[str, Any] = {}
    for child in element:
        before = "v" if child.tag == "velocity" else ""
        for leaf in child if len(child) else (child,):
            out[before + leaf.tag] = (leaf.text or "").strip()
    frame = out.get("frame")
    wanted = "Earth Fixed" if element.tag == "orbit" else "GM2000"
    if frame != wanted:
        raise LogFormatError(f"must be {wanted}", field=f"{element.tag}.frame", value=frame)
    return out


def _take(records: list[dict[str, Any]], names: str) -> FloatArray:
    values = np.empty((len(records), len(names.split())))
    for column, name in enumerate(names.split()):
        sign, key = (-1.0, name[1:]) if name.startswith("-") else (1.0, name)
        for row, record in enumerate(records):
            try:
                values[row, column] = sign * float(record[key])
            except (KeyError, ValueError):
                raise LogFormatError(
                    "is no number", field=key, row=row, value=record.get(key)
                ) from None
    return values


def _columns(names: str, values: FloatArray) -> Columns:
    return dict(zip(names.split(), np.ascontiguousarray(values.T), strict=True))
