"""Orbits and attitudes as CCSDS messages: OEM and AEM, to and from files.

The Orbit Ephemeris Message (CCSDS 502.0-B-3) and the Attitude Ephemeris Message (CCSDS 504.0-B-2)
are what agencies and tools such as GMAT, STK and Orekit exchange. Files hold kilometres, km/s and
UTC; here stand metres, m/s and elapsed SI seconds since an epoch. KVN text is written unless the
file's name ends in ``.xml``; both are read. It needs the extra ``ccsds`` (the package
``ccsds-ndm-py``).

Examples
--------
>>> import tempfile, pathlib
>>> path = pathlib.Path(tempfile.mkdtemp()) / "orbit.oem"
>>> r, v = [[7e6, 0.0, 0.0], [7e6, 4.5e5, 0.0]], [[0.0, 7.5e3, 0.0], [-482.0, 7.48e3, 0.0]]
>>> write_oem(path, "2026-01-01T00:00:00", [0.0, 60.0], r, v, object_name="SAT",
...           object_id="2026-001A")
>>> orbit = read_oem(path)
>>> orbit.epoch, orbit.t, orbit.r[1]
('2026-01-01T00:00:00.000', array([ 0., 60.]), array([7000000.,  450000.,       0.]))
"""

from __future__ import annotations

from celestcore.ccsds.aem import AttitudeMessage, read_aem, write_aem
from celestcore.ccsds.oem import OrbitMessage, read_oem, write_oem

__all__ = ["AttitudeMessage", "OrbitMessage", "read_aem", "read_oem", "write_aem", "write_oem"]
