"""A filter that goes over a log piece by piece."""

from __future__ import annotations

import copy
import dataclasses
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore._check import FloatArray, warn
from celestcore._fixes import configured_noise
from celestcore._replay import BIAS_SIGMA
from celestcore._tables import parts_of
from celestcore.errors import CelestcoreWarning
from celestcore.log import SensorLog
from celestcore.navigator import GAP_STEPS, StarGyroNavigator
from celestcore.replay._forward import Made, Source, health_table
from celestcore.replay._stuck import stuck
from celestcore.replay._windows import MOST, Piece, Splicer
from celestcore.solution import Solution
from celestcore.summary import MANY_REJECTED


@dataclass(frozen=True)
class State:
    """Where a filter stands."""

    t: float
    q: FloatArray
    bias: FloatArray
    covariance: FloatArray
    noise_scale: Mapping[str, float] | None = None
    """What each sensor's noise is multiplied by, where it is found as the filter runs."""

    @classmethod
    def of(cls, final: dict[str, Any], before: State | None) -> State:
        """Return the state at a solution's end; a sensor that was silent keeps its noise."""
        scale = final.get("noise_scale")
        if scale is not None and before is not None:
            scale = {**(before.noise_scale or {}), **scale}
        return cls(float(final["t"]), final["q"], final["bias"], final["covariance"], scale)

    def options(self) -> dict[str, Any]:
        """Return a run's options that go on from here."""
        own = {"t0": self.t, "q0": self.q, "bias0": self.bias, "covariance0": self.covariance}
        return {**own, "noise_scale0": self.noise_scale}


Q = ("qw", "qx", "qy", "qz")
CANDIDATES = 7
"""First fixes that a start is chosen from, as the core does."""
MAX_REJECTED = 20
"""Measurements refused running that end a filter's belief, unless a replay is told."""


class StarGyroForward:
    """The filter between two pieces: its state, and how much it has refused running."""

    def __init__(
        self, navigator: StarGyroNavigator, options: Mapping[str, Any], source: Source
    ) -> None:
        self.navigator, self.options = navigator, dict(options)
        if options["max_rejected"] == "default":
            self.options["max_rejected"] = MAX_REJECTED
        self.described = repr(navigator)
        self.state: State | None = None
        self.refused = 0
        self._again: float | None = None
        """Time from which the fixes are to be believed again, not the filter."""
        self.q: FloatArray | None = None
        """Quaternion of the last row: those that follow have its sign."""
        self._splicer = Splicer(options["every"], options["overlap"], source.epoch)
        self.push, self.skip = self._splicer.push, self._splicer.skip

    @property
    def reached(self) -> float:
        """Time of the state [s]."""
        return -np.inf if self.state is None else self.state.t

    @property
    def reading_from(self) -> float:
        """Time tag before which no row of a log is needed any more [s]."""
        return self.reached

    @property
    def late(self) -> dict[str, int]:
        """Rows that came after their time had passed, by table."""
        return self._splicer.late

    def kept(self) -> dict[str, Any] | None:
        """Return what a checkpoint keeps; None before the start."""
        if self.state is None:
            return None
        gap = self.navigator.gyro.max_gap
        own = dataclasses.asdict(self.state)
        more = {"max_gap": gap, "again": self._again, "row_q": self.q}
        return {**own, "refused": self.refused, **more}

    def restore(self, kept: dict[str, Any] | None, late: Mapping[str, int]) -> None:
        """Go on from what a checkpoint kept."""
        self._splicer.late = dict(late)
        if kept is None:
            return
        self._fix_gap(kept["max_gap"])
        self.refused, self._again, self.q = kept["refused"], kept["again"], kept["row_q"]
        self.state = State(**{f.name: kept[f.name] for f in dataclasses.fields(State)})
        self._splicer.reached = self.reached

    def finish(self, fixes: int, rejected: int) -> None:
        """Warn of many refused measurements."""
        if rejected > max(10, MANY_REJECTED * fixes):
            warn(
                f"{rejected} of {fixes} measurements were outside the gate: see what "
                "celestcore.replay.report says of when"
            )

    def step(self, *, last: bool) -> Made | None:
        """Go on as far as what is there allows; None if there is not enough for a row."""
        if self.state is None:
            look = self._splicer.look()
            if not last and look is not None and _undecided(look):
                return None
            begin = self.start_in(look)
            if begin is None:
                return None  # no fix to start from yet
            self._splicer.before = begin
        piece = self._splicer.take(last=last)
        return None if piece is None else self.over(piece)

    def _fix_gap(self, max_gap: float) -> None:
        """Take one longest step for the whole log: that of its first piece unless it is given."""
        self.navigator = copy.copy(self.navigator)
        self.navigator.gyro = dataclasses.replace(self.navigator.gyro, max_gap=max_gap)

    def start_in(self, log: SensorLog | None) -> int | None:
        """Return the gyro sample at or before the start, None without a fix to start from."""
        if log is None or log.gyro is None or not log.stars or len(log.gyro) < 2:
            return None
        first = min(float(table.t[0]) for table in log.stars.values())
        if first > log.gyro.t[-1]:
            return None
        given: dict[str, Any] = {"sigma0": _pair(self.options["sigma0"])}
        probe = self.navigator.run(log, every=len(log.gyro), innovations="none", **given)
        return int(np.searchsorted(log.gyro.t, probe.t[0], "right")) - 1

    def over(self, piece: Piece) -> Made:
        """Run over a piece."""
        log: SensorLog | None = piece.log
        assert log is not None
        assert log.gyro is not None
        if self.navigator.gyro.max_gap is None:
            self._fix_gap(GAP_STEPS * float(np.median(np.diff(log.gyro.t))))
        made = _Collected(self.options["innovations"], self.navigator, self.q)
        grid: FloatArray | None = None
        while log is not None:
            begin, again = self.state, self._again
            sol = self._run(log, begin, again)
            lost = self._lost(sol, log)
            rest = None
            if lost is not None:
                head, rest = _split(log, lost)
                self._again = lost
                made.restarts.append(lost)
                if head is None:
                    log = rest
                    continue
                log, sol = head, self._run(head, begin, again)
            shown = sol
            if piece.ahead is not None:
                shown = self._smoothed(piece.ahead, log, begin, again, float(sol.t[-1]))
            if grid is None:
                grid = _grid(piece.log, sol, self.options["every"])
            # what goes on begins with the last row of the one before; a start anew has rows of its
            # own wherever its fixes lie, of which those of the log's rhythm are kept
            kept = np.isin(shown.t, grid) if again is not None else np.ones(len(shown.t), bool)
            kept[0] &= begin is None or again is not None
            made.add(sol, shown, kept, goes_on=begin is not None)
            self.state = State.of(sol.final, begin)
            if lost is None:
                self._again = None
            log = rest
        self.q = made.q
        return made.made()

    def _run(self, log: SensorLog, begin: State | None, again: float | None) -> Solution:
        given: dict[str, Any] = {"sigma0": _pair(self.options["sigma0"])}
        every = self.options["every"]
        if begin is not None:
            given = begin.options()
        if begin is not None and again is not None:
            # lost: the attitude from the fixes, the bias as it was with a sigma as at a start
            given = {
                "bias0": begin.bias,
                "sigma0": (1.0, BIAS_SIGMA),
                "noise_scale0": begin.noise_scale,
            }
            every = 1
        with _gate_unsaid():
            return self.navigator.run(log, every=every, **given)

    def _smoothed(
        self,
        ahead: SensorLog,
        log: SensorLog,
        begin: State | None,
        again: float | None,
        end: float,
    ) -> Solution:
        """Return the rows of a smoother that knows what lies ahead."""
        assert log.gyro is not None
        after = ahead if begin is None else _from(ahead, float(log.gyro.t[0]))
        with _gate_unsaid():
            wide = self.navigator.smooth(self._run(after, begin, again))
        part: Solution = wide[: np.nextafter(end, np.inf)]
        return part

    def _lost(self, sol: Solution, log: SensorLog) -> float | None:
        """Return the time of the first of too many measurements that were refused running.

        Those of a sensor that hangs tell nothing of the filter.
        """
        most = self.options["max_rejected"]
        counts = ~stuck(sol, log) if most is not None else np.zeros(0, bool)
        if most is None or not counts.any():
            return None
        accepted, t = sol.accepted[counts], sol.measurement_t[counts]
        refused = ~accepted
        places = np.flatnonzero(accepted)
        before = refused[: places[0]].sum() if len(places) else len(refused)
        # a run of refusals that began in the piece before
        if self.refused and self.refused + before >= most and self.refused < most:
            self.refused = 0
            return float(t[0])
        run = np.convolve(refused, np.ones(most, int), "valid") if len(refused) >= most else None
        if run is not None and (run == most).any():
            self.refused = 0
            return float(t[int(np.argmax(run == most))])
        self.refused = int(len(refused) - 1 - places[-1]) if len(places) else self.refused + before
        return None


class _Collected:
    """Rows, measurements and health of a piece, of one solution or of several that follow."""

    def __init__(
        self, innovations: str, navigator: StarGyroNavigator, q: FloatArray | None
    ) -> None:
        self.innovations, self.navigator, self.q = innovations, navigator, q
        self.restarts: list[float] = []
        self._rows: list[dict[str, Any]] = []
        self._measurements: list[dict[str, Any]] = []
        self._health: list[dict[str, Any]] = []
        self._gaps: list[FloatArray] = []
        self._counts = {"samples": 0, "fixes": 0, "rejected": 0}
        self._likelihood = 0.0

    def add(
        self, sol: Solution, shown: Solution, kept: NDArray[np.bool_], *, goes_on: bool
    ) -> None:
        """Add a solution, and the rows that are kept of what is shown: its own or a smoother's."""
        first = 1 if goes_on else 0  # its first gyro sample is the last of the one before
        at = slice(1, None) if kept[1:].all() and not kept[0] else kept
        rows = {name: column[at] for name, column in shown.columns().items()}
        if len(rows["t"]):
            begin, end = (np.array([rows[name][k] for name in Q]) for k in (0, -1))
            if self.q is not None and begin @ self.q < 0.0:
                rows |= {name: -rows[name] for name in Q}
                end = -end
            self.q = end
        self._rows.append(rows)
        measured = sol.measurement_columns()
        if self.innovations != "none":
            names = list(measured) if self.innovations == "full" else list(measured)[:5]
            self._measurements.append({name: measured[name] for name in names})
        told = None if sol.source is None else configured_noise(self.navigator, sol.source[0])
        self._health.append(health(sol, told or {}))
        self._gaps.append(sol.gaps)
        self._counts["samples"] += sol.counts["samples"] - first
        self._counts["fixes"] += sol.counts["fixes"]
        self._counts["rejected"] += sol.counts["rejected"]
        self._likelihood += sol.log_likelihood

    def made(self) -> Made:
        """Return all of it."""
        tables = {"rows": _stacked(self._rows), "health": _stacked(self._health)}
        tables["events"] = events(np.concatenate(self._gaps), self.restarts)
        if self._measurements:
            tables["measurements"] = _stacked(self._measurements)
        return Made(tables, **self._counts, log_likelihood=self._likelihood, restarts=self.restarts)


def health(sol: Solution, told: Mapping[str, FloatArray]) -> dict[str, Any]:
    """Return how each sensor fared over a solution, and the noise that the filter was told."""
    sensors = {}
    for number, name in enumerate(sol.sensor_names):
        own = sol.sensor == number
        sensors[name] = sol.nis[own], sol.dof[own], sol.accepted[own]
    span = float(sol.t[0]), float(sol.t[-1])
    return health_table(span, sensors, told, sol.final.get("noise_scale"))


def events(gaps: FloatArray, restarts: list[float]) -> dict[str, Any]:
    """Return the gyro's gaps and the starts anew in order of time."""
    begin = np.concatenate([gaps[:, 0], np.asarray(restarts)])
    end = np.concatenate([gaps[:, 1], np.asarray(restarts)])
    kind = np.array(["gap"] * len(gaps) + ["restart"] * len(restarts), dtype="<U8")
    order = np.argsort(begin, kind="stable")
    return {"t": begin[order], "t_end": end[order], "kind": kind[order]}


@contextmanager
def _gate_unsaid() -> Iterator[None]:
    """Leave what a gate refused to the end: it is not said of every piece and every start anew."""
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", ".* outside the gate", CelestcoreWarning)
        yield


def _pair(sigma: list[float] | None) -> tuple[list[float], list[float]] | None:
    return None if sigma is None else (sigma[:3], sigma[3:])


def _undecided(log: SensorLog) -> bool:
    """Tell whether more fixes may choose another start: it is that of most of the first ones."""
    assert log.gyro is not None
    fixes = sum(int((table.t <= log.gyro.t[-1]).sum()) for table in log.stars.values())
    return fixes < CANDIDATES and len(log.gyro) < MOST


def _grid(log: SensorLog, sol: Solution, every: int) -> FloatArray:
    """Return the times of a piece's rows: every so many samples from where it began."""
    assert log.gyro is not None
    begin = int(np.searchsorted(log.gyro.t, sol.t[0], "right")) - 1
    return log.gyro.t[max(begin, 0) :: every]


def _stacked(tables: list[dict[str, Any]]) -> dict[str, Any]:
    if len(tables) == 1:
        return tables[0]
    return {name: np.concatenate([table[name] for table in tables]) for name in tables[0]}


def _split(log: SensorLog, t: float) -> tuple[SensorLog | None, SensorLog]:
    """Return a log up to the last gyro sample before time t, and from there on."""
    assert log.gyro is not None
    at = int(np.searchsorted(log.gyro.t, t, "left")) - 1
    edge = float(log.gyro.t[max(at, 0)])
    head = _between(log, -np.inf, edge) if at >= 1 else None
    return head, _from(log, edge)


def _from(log: SensorLog, t: float) -> SensorLog:
    return _between(log, t, np.inf)


def _between(log: SensorLog, begin: float, end: float) -> SensorLog:
    """Return a log's rows between two gyro samples; measurements at the first belong before it."""
    tables: dict[str, Any] = {}
    for name, table in log.tables.items():
        columns = parts_of(table)
        t = columns[0]
        keep = (t >= begin) if name == "gyro" or begin == -np.inf else (t > begin)
        keep &= t <= end
        if keep.any():
            tables[name] = tuple(column[keep] for column in columns)
    return SensorLog(epoch=log.epoch, **tables)
