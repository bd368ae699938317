"""Logs of any format, read piece by piece, and the formats of other tools.

`open_log` opens a log and reads it as it is used, in chunks or in windows of time; `celestcore
formats` lists what it knows. These options go with a format:

=========  =====================================================================================
parquet    ``table=``: which sensor's rows one file holds
aem, oem   ``segment=``: which of several
packets    ``definition=``: the XTCE file; ``columns=``: which parameter is which column (a
           dictionary, a TOML file or ``"jpss"``); ``apid=``, ``skip=`` bytes before each packet,
           ``skew=`` s
ck         ``kernels=``: clock, leap seconds, frames; ``instrument=``, ``frame=``, ``period=`` s
=========  =====================================================================================

Another package adds a format with an entry point of the group ``celestcore.readers`` that names a
`Format`; its reader returns a `Source` of `Lane`.

Examples
--------
>>> import celestcore as cc
>>> with open_log(cc.sample_path("noaa20")) as stream:
...     for window in stream.windows(3600.0, start=0.0):
...         print(window.start, {n: len(c["t"]) for n, c in window.tables.items()})
0.0 {'gnss': 3600, 'star': 3600}
3600.0 {'gnss': 3600, 'star': 3599}
"""

from __future__ import annotations

from celestcore.formats._model import Lane, Source
from celestcore.formats._registry import Format, formats
from celestcore.formats._stamps import Stamps
from celestcore.formats._stream import LogStream, open_log
from celestcore.formats._timeline import Jump, SensorReport
from celestcore.formats._windows import Window
from celestcore.formats._write import export

__all__ = [
    "Format",
    "Jump",
    "Lane",
    "LogStream",
    "SensorReport",
    "Source",
    "Stamps",
    "Window",
    "export",
    "formats",
    "open_log",
]
