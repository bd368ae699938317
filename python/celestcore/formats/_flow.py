"""One lane on its way to the reader: chunks in, rows in order of time out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from celestcore._check import warn
from celestcore.errors import LogFormatError
from celestcore.formats._model import Chunk, Columns, Lane, faults
from celestcore.formats._stamps import Clock, Stamps
from celestcore.formats._timeline import SensorReport, Timeline


@dataclass(frozen=True)
class Rules:
    """How a log is to be read: what `open_log` was told."""

    chunk_rows: int
    reorder: float | None = None
    jump: float | None = None
    keep_damaged: bool = False
    epoch: str | None = None
    stamps: Mapping[str, Stamps] = field(default_factory=dict)
    ranges: Mapping[str, tuple[int, int | None]] = field(default_factory=dict)
    """Of each sensor the rows (those with a time) that belong to this part of a split log."""


class Flow:
    """A pass over one lane; `pull` until it returns None."""

    def __init__(
        self,
        lane: Lane,
        rules: Rules,
        name: str,
        reports: dict[str, SensorReport],
        start: float | None = None,
    ) -> None:
        self.lane, self.rules, self.name, self.start = lane, rules, name, start
        self._chunks: Iterator[Chunk] | None = None
        self._horizon = -np.inf
        self.damage: str | None = None
        self.lines = {
            sensor: Timeline(
                sensor,
                Clock(rules.stamps.get(sensor, Stamps()), rules.epoch, f"{sensor}.t"),
                rules.reorder,
                rules.jump,
                reports[sensor],
                rules.ranges.get(sensor),
            )
            for sensor in lane.sensors
        }

    def floor(self) -> float:
        """Return the time before which no row of any sensor is still to come."""
        return min((line.floor for line in self.lines.values()), default=np.inf)

    def pull(self) -> dict[str, list[Columns]] | None:
        """Return the next rows of some sensors, None at the end."""
        with faults(self.name):
            if self._chunks is None:
                self._chunks = self._begin()
            try:
                chunk = next(self._chunks, None)
            except LogFormatError as error:
                if not self.rules.keep_damaged:
                    raise
                self.damage = str(error)
                warn(f"{self.name}: kept what stands before the damage: {error}")
                chunk = None
            if chunk is None:
                return self._finish()
            return self._feed(chunk)

    def _begin(self) -> Iterator[Chunk]:
        rows, lane = self.rules.chunk_rows, self.lane
        plain = not any(self.rules.stamps.get(n, Stamps()) != Stamps() for n in lane.sensors)
        if self.start is None or lane.read_from is None or not plain or self.rules.ranges:
            return lane.read(rows)
        return lane.read_from(rows, self.start)

    def _feed(self, chunk: Chunk) -> dict[str, list[Columns]]:
        out = {name: self.lines[name].feed(columns) for name, columns in chunk.items()}
        if len(self.lines) > 1:
            newest = max(line.newest for line in self.lines.values())
            self._horizon = max(self._horizon, newest - self.lane.skew)
            for name, line in self.lines.items():
                out.setdefault(name, []).extend(line.advance(self._horizon))
        return out

    def _finish(self) -> dict[str, list[Columns]] | None:
        if not self.lines:
            return None
        out = {name: line.finish() for name, line in self.lines.items()}
        self.lines = {}
        return out

    def close(self) -> None:
        """End the pass, which closes the reader's file."""
        close = getattr(self._chunks, "close", None)
        if close is not None:
            close()
