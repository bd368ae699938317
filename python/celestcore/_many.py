"""Several logs through one navigator, eight side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any

from celestcore import _core, _replay
from celestcore._arguments import processors
from celestcore._check import warn
from celestcore.errors import InputError
from celestcore.log import SensorLog
from celestcore.solution import Solution

if TYPE_CHECKING:
    from celestcore.navigator import StarGyroNavigator


def run_many(
    nav: StarGyroNavigator,
    logs: Iterable[SensorLog],
    threads: int | None,
    options: Mapping[str, Any],
) -> list[Solution | None]:
    """Return a solution for each log, None where the filter broke down."""
    if isinstance(logs, SensorLog):
        raise InputError("is one log; use run for it, or give a list", field="logs")
    if not isinstance(logs, Iterable):
        raise InputError("must be a list of SensorLog", field="logs", value=logs)
    workers = processors(threads, alone=True)
    _replay.checked_options(options)
    given = list(logs)
    calls: list[tuple[dict[str, Any], list[str]]] = []
    for i, log in enumerate(given):
        try:
            calls.append(_replay.prepare(nav, log, options))
        except InputError as error:
            raise error.located(f"log {i}") from None
    found = _core.replay_many([call for call, _ in calls], workers)
    solutions: list[Solution | None] = []
    for i, (log, (call, names), out) in enumerate(zip(given, calls, found, strict=True)):
        if isinstance(out, str):
            warn(f"log {i} has no solution: {out}")
            solutions.append(None)
            continue
        source = (log, dict(options))
        solutions.append(
            _replay.finish(nav, log, names, call, out, label=f"log {i}: ", source=source)
        )
    return solutions
