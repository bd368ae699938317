"""Logs larger than memory: replayed window by window, and gone on with after whatever stopped it.

A replay reads a log in windows of time, filters each while the next is read, and writes part after
part of its results. A checkpoint remembers how far it has come; from there it goes on to the same
bits, be it after Ctrl-C, a killed process or a power cut.

Examples
--------
>>> import celestcore as cc
>>> from tempfile import TemporaryDirectory
>>> log = cc.sample("fermi")
>>> nav = cc.Settings.from_log(log).navigator()
>>> with TemporaryDirectory() as folder:
...     summary = run(log, nav, f"{folder}/out", window=3600.0, every=10)
...     rows = read(f"{folder}/out")["rows"]
>>> summary.rows == len(rows["t"])
True
"""

from __future__ import annotations

from celestcore.replay._checkpoint import Checkpoint, read_checkpoint
from celestcore.replay._parts import read
from celestcore.replay._report import report
from celestcore.replay._run import Summary, run

__all__ = ["Checkpoint", "Summary", "read", "read_checkpoint", "report", "run"]
