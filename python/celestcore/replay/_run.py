"""A replay: window after window through a filter, part after part to the disk."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from celestcore._arguments import checked, count
from celestcore._check import number, warn
from celestcore._files import replacing
from celestcore.errors import InputError
from celestcore.formats import LogStream
from celestcore.formats._windows import Ahead
from celestcore.log import SensorLog
from celestcore.navigator import StarGyroNavigator
from celestcore.replay._checkpoint import Checkpoint, read_checkpoint, write_through
from celestcore.replay._filter import Forward
from celestcore.replay._parts import Parts
from celestcore.replay._source import Stretch, Tables, epoch_of, stretches
from celestcore.replay._windows import Splicer
from celestcore.solution import package_version
from celestcore.summary import MANY_REJECTED

__all__ = ["Summary", "run"]

Progress = Callable[[float], object]
KEPT = ("full", "nis", "none")


@dataclass
class Summary:
    """What a replay has done.

    Attributes
    ----------
    rows, parts, windows : int
        Output rows, parts written, windows read; of all runs together if it was resumed.
    samples, fixes, rejected : int
        Gyro samples used, measurements seen, and refused by the gate.
    late : dict of str to int
        Measurements and samples that came after their time had passed, by table.
    restarts : list of float
        Times at which the filter refused too many fixes running and started again [s].
    log_likelihood : float
        Of the measurements used.
    resumed : bool
        Whether it went on from a checkpoint.
    elapsed_s : float
        Time of this run [s].

    Examples
    --------
    >>> Summary(rows=3).rows
    3
    """

    rows: int = 0
    parts: int = 0
    windows: int = 0
    samples: int = 0
    fixes: int = 0
    rejected: int = 0
    late: dict[str, int] = field(default_factory=dict)
    restarts: list[float] = field(default_factory=list)
    log_likelihood: float = 0.0
    resumed: bool = False
    elapsed_s: float = 0.0


def run(
    source: SensorLog | LogStream | Iterable[Tables],
    navigator: StarGyroNavigator,
    out: str | os.PathLike[str],
    *,
    window: float = 3600.0,
    every: int = 1,
    innovations: str = "full",
    smooth: bool = False,
    overlap: float = 600.0,
    max_rejected: int | None = 20,
    checkpoint: str | os.PathLike[str] | None = None,
    interval: float = 30.0,
    resume: bool = False,
    epoch: Any = None,
    progress: Progress | None = None,
) -> Summary:
    """Replay a log of any length in bounded memory, so that nothing is lost.

    Parameters
    ----------
    source : SensorLog, LogStream or iterable of windows
        A log; a stream of a file by `celestcore.formats.open_log`; or windows in order of time,
        each a mapping from table names to what `SensorLog` takes, for example ``{"gyro": (t,
        rate), "star": (t, q)}``. Windows do not overlap; a sensor may be absent from one.
    navigator : StarGyroNavigator
        The filter.
    out : path
        A folder for the results: tables ``rows``, ``measurements`` and ``health`` as Parquet
        datasets, and ``summary.json`` at the end.
    window : float
        Length of a window of a log or stream [s].
    every : int
        One output row every so many gyro samples.
    innovations : {"full", "nis", "none"}
        What to keep of each measurement.
    smooth : bool
        Whether rows come from a smoother that knows the fixes of the next `overlap` seconds.
    overlap : float
        How far the smoother looks ahead [s]: beyond some settling times of the filter it gains
        nothing.
    max_rejected : int, optional
        So many measurements refused running end the filter's belief: it starts again from the
        fixes there, with the bias it had and a sigma as at a start. None: never.
    checkpoint : path, optional
        A file that remembers how far the replay has come.
    interval : float
        Least time between two checkpoints [s].
    resume : bool
        Whether to go on from `checkpoint`: from the same log, navigator and options to the same
        bits as without a stop. Without the file yet it begins anew.
    epoch : str or astropy Time, optional
        Where times of windows count from.
    progress : callable, optional
        ``progress(t)`` with the time reached [s], after each part.

    Returns
    -------
    Summary

    Raises
    ------
    InputError
        An output folder that holds another replay, a damaged checkpoint or one of another job.
    NumericalError
        A covariance that is no longer positive definite; the parts before it are kept.
    OSError
        A full disk; the parts before it are kept.

    Examples
    --------
    >>> import celestcore as cc
    >>> from tempfile import TemporaryDirectory
    >>> log = cc.sample("fermi")
    >>> nav = cc.Settings.from_log(log).navigator()
    >>> with TemporaryDirectory() as folder:
    ...     done = run(log, nav, f"{folder}/out", every=60, checkpoint=f"{folder}/c.json")
    >>> done.samples
    43195
    """
    checked(navigator, "navigator", StarGyroNavigator)
    if innovations not in KEPT:
        raise InputError(
            f"must be one of {', '.join(KEPT)}", field="innovations", value=innovations
        )
    options = {
        "every": count(every, "every"),
        "innovations": innovations,
        "smooth": bool(smooth),
        "overlap": number(overlap, "overlap", above=0.0) if smooth else 0.0,
        "max_rejected": None if max_rejected is None else count(max_rejected, "max_rejected"),
    }
    seconds = number(window, "window", above=0.0)
    if isinstance(source, SensorLog | LogStream):
        options["window"] = seconds
    if resume and checkpoint is None:
        raise InputError("is needed to resume", field="checkpoint")
    job = _Job(navigator, options, epoch_of(source, epoch), Path(out))
    memory = (checkpoint, number(interval, "interval", at_least=0.0))

    def windows(reached: float) -> Iterator[Stretch]:
        return stretches(source, seconds, reached)

    return job.run(windows, memory, resume, progress)


class _Job:
    """One replay."""

    def __init__(
        self, navigator: StarGyroNavigator, options: dict[str, Any], epoch: Any, out: Path
    ) -> None:
        self.navigator, self.options, self.epoch, self.out = navigator, options, epoch, out
        note = {"version": package_version(), "filter": navigator.filter.kind, "options": options}
        self.note = {**note, "epoch": None if epoch is None else str(epoch), "gate": navigator.gate}
        what = json.dumps(self.note, sort_keys=True) + repr(navigator)
        self.digest = hashlib.sha256(what.encode()).hexdigest()
        self.parts = Parts(out, self.note)

    def run(
        self,
        windows: Callable[[float], Iterator[Stretch]],
        memory: tuple[Any, float],
        resume: bool,
        progress: Progress | None,
    ) -> Summary:
        began = time.perf_counter()
        path, interval = memory
        known = self._known(path) if resume else None
        self.parts.begin(None if known is None else known.parts)
        splicer = Splicer(self.options["every"], self.options["overlap"], self.epoch)
        forward = Forward(self.navigator, self.options)
        summary = Summary()
        if known is not None:
            summary = Summary(**{**known.counts, "resumed": True})
            forward.restore(known.state)
            splicer.reached = forward.reached
            splicer.late = dict(summary.late)
        if path is not None and known is None:
            # at once: parts without a checkpoint could not be gone on with
            self._checkpoint(path, -np.inf, splicer, forward, summary)
        written = time.monotonic()
        for window in Ahead(windows(splicer.reached), 1):
            if known is not None and window.known <= known.upto:
                splicer.skip(window.tables)
                continue
            splicer.push(window.tables)
            summary.windows += 1
            self._step(splicer, forward, summary, last=False, progress=progress)
            if path is not None and time.monotonic() - written >= interval:
                self._checkpoint(path, window.known, splicer, forward, summary)
                written = time.monotonic()
        self._step(splicer, forward, summary, last=True, progress=progress)
        summary.elapsed_s = time.perf_counter() - began
        self._finish(splicer, summary)
        return summary

    def _known(self, path: Any) -> Checkpoint | None:
        if not Path(path).exists():
            warn(f"there is no checkpoint {os.fspath(path)} yet: the replay begins anew")
            return None
        known = read_checkpoint(path)
        if known.job != self.digest:
            raise InputError(
                "is of a replay with another navigator or other options: go on with the same, or "
                "begin anew with another file and folder",
                field="checkpoint",
                value=os.fspath(path),
            )
        return known

    def _checkpoint(
        self, path: Any, upto: float, splicer: Splicer, forward: Forward, summary: Summary
    ) -> None:
        self.parts.sync()
        summary.late = dict(splicer.late)
        counts = dataclasses.asdict(summary)
        state = forward.state
        Checkpoint(
            self.digest,
            upto,
            summary.parts,
            None if state is None else forward.kept(),
            counts,
        ).write(path)

    def _step(
        self,
        splicer: Splicer,
        forward: Forward,
        summary: Summary,
        *,
        last: bool,
        progress: Progress | None,
    ) -> None:
        if forward.state is None:
            begin = forward.start_in(splicer.look())
            if begin is None:
                return  # no fix to start from yet
            splicer.before = begin
        piece = splicer.take(last=last)
        if piece is None:
            return
        made = forward.over(piece)
        self.parts.write(summary.parts, made.tables)
        summary.parts += 1
        summary.rows += len(made.tables["rows"]["t"])
        summary.samples += made.samples
        summary.fixes += made.fixes
        summary.rejected += made.rejected
        summary.restarts += made.restarts
        summary.log_likelihood += made.log_likelihood
        if progress is not None:
            progress(forward.reached)

    def _finish(self, splicer: Splicer, summary: Summary) -> None:
        self.parts.sync()
        summary.late = dict(splicer.late)
        text = json.dumps({**self.note, **dataclasses.asdict(summary)}, indent=1)
        with replacing(self.out / "summary.json") as temporary:
            write_through(temporary, text.encode())
        if summary.late:
            lost = ", ".join(f"{n} of {name}" for name, n in summary.late.items())
            warn(f"rows came after their time had passed and were left out: {lost}")
        if summary.rejected > max(10, MANY_REJECTED * summary.fixes):
            warn(
                f"{summary.rejected} of {summary.fixes} measurements were outside the gate: see "
                "what celestcore.replay.report says of when"
            )
        if summary.restarts:
            first = ", ".join(f"{t:.6g}" for t in summary.restarts[:5])
            more = " ..." if len(summary.restarts) > 5 else ""
            warn(
                f"the filter refused {self.options['max_rejected']} fixes running and started "
                f"again at t = {first}{more} s"
            )
