"""How long celestcore takes, and how long others take for the same work in the same run.

`measure` is what ``celestcore bench`` calls. Every peer's result is compared with celestcore's
before its time counts. A yardstick is a program of hand-written kernels that prints JSON lines
``{"task": ..., "peer": ..., "ns": ...}``.

Examples
--------
>>> from celestcore import bench
>>> report = bench.measure(["systematic", "residual"], quick=True)
>>> [row.work.name for row in report.rows]
['systematic', 'residual']
"""

from __future__ import annotations

from celestcore.bench._measure import measure
from celestcore.bench._report import Report

__all__ = ["Report", "measure"]
