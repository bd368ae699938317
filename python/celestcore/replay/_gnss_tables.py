"""What a piece of a GNSS and star navigator's run looks like on the disk."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from celestcore.gnss import GnssStarSolution, Innovations
from celestcore.replay._forward import health_table

DOF = 3
AXES = ("x", "y", "z")


def tables_of(
    sol: GnssStarSolution,
    sensors: Sequence[str],
    options: Any,
    before: tuple[float, int],
) -> dict[str, dict[str, Any]]:
    """Return rows, measurements and health; `before` is the time and the rows before the piece."""
    reached, count = before
    first = -count % options["every"]
    columns = sol.columns()
    made = {"rows": {name: c[first :: options["every"]] for name, c in columns.items()}}
    begin = reached if np.isfinite(reached) else float(sol.t[0])
    both = (sol.gnss, sol.attitude)
    seen = {name: _seen(both, name) for name in sensors}
    made["health"] = health_table((begin, float(sol.t[-1])), seen)
    if options["innovations"] != "none":
        made["measurements"] = _measurements(both, full=options["innovations"] == "full")
    return made


def _seen(both: Sequence[Innovations], name: str) -> tuple[Any, Any, Any]:
    rows = [(m.nis[m.kind == name], m.accepted[m.kind == name]) for m in both]
    nis, accepted = (np.concatenate(column) for column in zip(*rows, strict=True))
    return nis, np.full(len(nis), DOF), accepted


def _measurements(both: Sequence[Innovations], *, full: bool) -> dict[str, Any]:
    """Return the measurements of both filters in order of time, the receiver's first."""
    t = np.concatenate([m.t for m in both])
    order = np.argsort(t, kind="stable")

    def column(parts: list[Any]) -> Any:
        return np.concatenate(parts)[order]

    out = {
        "t": t[order],
        "sensor": column([np.asarray(m.kind, dtype=object) for m in both]),
        "nis": column([m.nis for m in both]),
        "dof": np.full(len(t), DOF),
        "accepted": column([m.accepted for m in both]),
    }
    if full:
        for prefix, parts in (
            ("i", [m.innovation for m in both]),
            ("s_i", [m.sigma for m in both]),
        ):
            rows = column(parts).T
            out |= {f"{prefix}{axis}": c.copy() for axis, c in zip(AXES, rows, strict=True)}
    return out


def counts_of(both: Sequence[Innovations]) -> dict[str, int]:
    """Return how many measurements there were of each kind, and how many were refused."""
    out: dict[str, int] = {}
    for measured in both:
        for name in np.unique(np.asarray(measured.kind, dtype=str)):
            own = measured.kind == name
            out[str(name)] = int(own.sum())
            out[f"{name}_rejected"] = int((own & ~measured.accepted).sum())
    return out
