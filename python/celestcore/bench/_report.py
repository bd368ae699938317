"""`Report`: every figure of a measurement, for people and for machines."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from celestcore.bench._clock import CLOCK
from celestcore.bench._session import Row
from celestcore.bench._work import Target
from celestcore.bench._yardstick import Yardstick

BETTER = {
    "limit": "celestcore's time over the yardstick's: smaller is better",
    "peers": "the peer's time over celestcore's: larger is better for celestcore",
}


@dataclass(frozen=True)
class Report:
    """What `measure` found.

    Attributes
    ----------
    machine : dict
        Date, processor, instruction set, versions.
    rows : list
        One for each work.
    peers : dict of str to str
        Versions of the peers that were there.
    skipped : dict of str to str
        Peers that were not, and how to install them.
    yardsticks : list
        Programs that were run.
    instructions : dict of str to float
        Instructions for each item of kernels.
    options : dict
        What was asked for.

    Examples
    --------
    >>> from celestcore import bench
    >>> report = bench.measure(["systematic"], quick=True)
    >>> report.to_dict()["works"][0]["unit"]
    'ns per particle'
    """

    machine: dict[str, Any]
    rows: list[Row]
    peers: dict[str, str] = field(default_factory=dict)
    skipped: dict[str, str] = field(default_factory=dict)
    yardsticks: list[Yardstick] = field(default_factory=list)
    instructions: dict[str, float] = field(default_factory=dict)
    options: dict[str, Any] = field(default_factory=dict)

    def to_dict(self) -> dict[str, Any]:
        """Return every figure with its unit and its ratio, ready for JSON.

        Returns
        -------
        dict
            machine, clock, better, options, peers, skipped, yardsticks, works.

        Examples
        --------
        >>> from celestcore import bench
        >>> sorted(bench.measure(["systematic"], quick=True).to_dict())[:4]
        ['better', 'clock', 'machine', 'options']
        """
        return {
            "machine": self.machine,
            "clock": CLOCK,
            "better": BETTER,
            "options": self.options,
            "peers": self.peers,
            "skipped": self.skipped,
            "yardsticks": [yardstick.name for yardstick in self.yardsticks],
            "works": [self._work(row) for row in self.rows],
        }

    def to_markdown(self) -> str:
        """Return the section for ``docs/benchmarks.md``, with the day and the processor.

        Returns
        -------
        str

        Examples
        --------
        >>> from celestcore import bench
        >>> text = bench.measure(["systematic"], quick=True).to_markdown()
        >>> text.startswith("## 2")
        True
        """
        from celestcore.bench._markdown import section

        return section(self)

    def limit(self, row: Row) -> tuple[float, str] | None:
        """Return the fastest yardstick's time of a work [ns an item] and who took it, or None.

        Parameters
        ----------
        row : Row
            One of `rows`.

        Examples
        --------
        >>> from celestcore import bench
        >>> report = bench.measure(["systematic"], quick=True)
        >>> report.limit(report.rows[0]) is None
        True
        """
        names = (row.work.task, row.work.name)
        found = [y.found[name] for y in self.yardsticks for name in names if name in y.found]
        return min(found, default=None)

    def reached(self, row: Row) -> tuple[float, bool] | None:
        """Return what a work's target is held against, and whether it is met.

        Parameters
        ----------
        row : Row
            One of `rows`.

        Returns
        -------
        (float, bool) or None
            The ratio, or the time [ns] where the target is one; None where nothing can be said.

        Examples
        --------
        >>> from celestcore import bench
        >>> report = bench.measure(["systematic"], quick=True)
        >>> report.reached(report.rows[0]) is None  # there is no yardstick
        True
        """
        target = row.work.target
        if target is None or math.isnan(row.ns):
            return None
        if target.of == "ns":
            return row.ns, row.ns <= target.most
        against = self._against(row, target)
        if against is None:
            return None
        ratio = row.ns / against
        return ratio, ratio <= target.most

    def _against(self, row: Row, target: Target) -> float | None:
        if target.of == "limit":
            limit = self.limit(row)
            return None if limit is None else limit[0]
        others = [r.ns for r in self.rows if r.work.name == target.of and not math.isnan(r.ns)]
        return others[0] if others else None

    def _work(self, row: Row) -> dict[str, Any]:
        work, limit, reached = row.work, self.limit(row), self.reached(row)
        out: dict[str, Any] = {
            "name": work.name,
            "title": work.title,
            "unit": f"ns per {work.item}",
            "celestcore": None if math.isnan(row.ns) else row.ns,
            "left_out": row.left_out,
            "limit": None,
            "base": None,
            "target": None,
            "peers": {n: {"ns": ns, "ratio": ns / row.ns} for n, ns in row.peers.items()},
            "refused": row.refused,
            "instructions": self.instructions.get(work.kernel or ""),
        }
        if limit is not None:
            out["limit"] = {"ns": limit[0], "by": limit[1], "ratio": row.ns / limit[0]}
            if math.isnan(row.ns):
                out["limit"]["ratio"] = None
        if row.base is not None:
            out["base"] = {"what": work.base, "ns": row.base, "ratio": row.ns / row.base}
        if work.target is not None:
            value, met = (None, None) if reached is None else reached
            target = {"most": work.target.most, "of": work.target.of}
            out["target"] = {**target, "value": value, "met": met}
        return out
