"""A replay: window after window through a filter, part after part to the disk."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import closing
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from celestcore._arguments import Sigma0, count, sigma_of
from celestcore._check import number, warn
from celestcore._files import replacing
from celestcore.errors import InputError
from celestcore.formats import LogStream
from celestcore.formats._windows import Ahead
from celestcore.log import SensorLog
from celestcore.replay._background import Background
from celestcore.replay._checkpoint import Checkpoint, read_checkpoint, write_through
from celestcore.replay._forward import Forward, Source
from celestcore.replay._kinds import forward_of
from celestcore.replay._parts import Parts
from celestcore.replay._source import (
    Stretch,
    Tables,
    epoch_of,
    known_by,
    names_of,
    stretches,
    window_of,
)
from celestcore.solution import package_version

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarNavigator
    from celestcore.navigator import StarGyroNavigator

__all__ = ["Summary", "run"]

Progress = Callable[[float], object]
KEPT = ("full", "nis", "none")
WAITING = 1
"""Parts that wait to be written, besides the one that is: each holds a window's rows."""


@dataclass
class Summary:
    """What a replay has done.

    Attributes
    ----------
    rows, parts, windows : int
        Output rows, parts written, windows read; of all runs together if it was resumed.
    samples, fixes, rejected : int
        Gyro samples used, measurements seen, and refused by the gate; a GNSS fix with a velocity
        is two.
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
    navigator: StarGyroNavigator | GnssStarNavigator,
    out: str | os.PathLike[str],
    *,
    window: float | None = None,
    every: int = 1,
    innovations: str = "full",
    smooth: bool = False,
    overlap: float = 600.0,
    sigma0: Sigma0 | None = None,
    max_rejected: int | Literal["default"] | None = "default",
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
    navigator : StarGyroNavigator or GnssStarNavigator
        The filter. The second one starts from the first fixes and is not smoothed in parts; a slow
        error with harmonics needs `LowFrequencyError(period=...)`.
    out : path
        A folder for the results: tables ``rows``, ``measurements``, ``health`` and ``events`` as
        Parquet datasets, and ``summary.json`` at the end.
    window : float, optional
        Length of a window of a log or stream [s]; what holds about 100 000 gyro samples, or
        200 000 with `every`, unless it is given. Memory grows with it.
    every : int
        One output row every so many gyro samples, or fixes' times of a `GnssStarNavigator`.
    innovations : {"full", "nis", "none"}
        What to keep of each measurement.
    smooth : bool
        Whether rows come from a smoother that knows the fixes of the next `overlap` seconds.
    overlap : float
        How far the smoother looks ahead [s]: beyond some settling times of the filter it gains
        nothing.
    sigma0 : (attitude, bias), optional
        1-sigma of the start [rad], [rad/s], as `StarGyroNavigator.run`; the attitude's is that of
        the first fix.
    max_rejected : int, optional
        So many measurements refused running end the filter's belief: it starts again from the
        fixes there, with the bias it had and a sigma as at a start; 20 by default. None: never. A
        `GnssStarNavigator` has its own and starts again as in its `run`.
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
        ``progress(t)`` with the time reached [s], after each part is filtered; it may still be on
        its way to the disk.

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
    if innovations not in KEPT:
        raise InputError(
            f"must be one of {', '.join(KEPT)}", field="innovations", value=innovations
        )
    options: dict[str, Any] = {
        "every": count(every, "every"),
        "innovations": innovations,
        "smooth": bool(smooth),
        "overlap": number(overlap, "overlap", above=0.0) if smooth else 0.0,
        "sigma0": None if sigma0 is None else sigma_of(sigma0).tolist(),
        "max_rejected": max_rejected,
    }
    if max_rejected is not None and max_rejected != "default":
        options["max_rejected"] = count(max_rejected, "max_rejected")
    seconds = (
        window_of(source, options["every"])
        if window is None
        else number(window, "window", above=0.0)
    )
    if isinstance(source, SensorLog | LogStream):
        options["window"] = seconds
    if isinstance(source, LogStream) and (reading := source._reading()):
        options["reading"] = reading
    if resume and checkpoint is None:
        raise InputError("is needed to resume", field="checkpoint")
    known = Source(epoch_of(source, epoch), names_of(source))
    forward = forward_of(navigator, options, known)
    told = {
        "filter": navigator.filter.kind,
        "gate": navigator.gate,
        "log": known_by(source),
    }
    job = _Job(forward, told, known, Path(out))
    memory = (checkpoint, number(interval, "interval", at_least=0.0))

    def windows(reached: float) -> Iterator[Stretch]:
        return stretches(source, seconds, reached)

    return job.run(windows, memory, resume, progress)


class _Job:
    """One replay."""

    def __init__(self, forward: Forward, told: dict[str, Any], source: Source, out: Path) -> None:
        self.forward, self.options, self.out = forward, dict(forward.options), out
        note = {"version": package_version(), "options": self.options, **told}
        self.note = {**note, "epoch": None if source.epoch is None else str(source.epoch)}
        what = json.dumps(self.note, sort_keys=True) + forward.described
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
        forward, summary = self.forward, Summary()
        if known is not None:
            summary = Summary(**{**known.counts, "resumed": True})
            forward.restore(known.state, summary.late)
        # read, filtered and written side by side; `with` ends both threads whatever happens
        with (
            closing(iter(Ahead(windows(forward.reading_from), 1))) as ahead,
            Background(WAITING) as writer,
        ):
            if path is not None and known is None:
                # at once: parts without a checkpoint could not be gone on with
                writer.do(self._checkpoint(path, -np.inf, forward, summary))
            written = time.monotonic()
            for window in ahead:
                if known is not None and window.known <= known.upto:
                    forward.skip(window.tables)
                    continue
                forward.push(window.tables)
                summary.windows += 1
                self._step(forward, summary, writer, last=False, progress=progress)
                if path is not None and time.monotonic() - written >= interval:
                    writer.do(self._checkpoint(path, window.known, forward, summary))
                    written = time.monotonic()
            self._step(forward, summary, writer, last=True, progress=progress)
        summary.elapsed_s = time.perf_counter() - began
        self._finish(forward, summary)
        return summary

    def _known(self, path: Any) -> Checkpoint | None:
        if not Path(path).exists():
            warn(f"there is no checkpoint {os.fspath(path)} yet: the replay begins anew")
            return None
        known = read_checkpoint(path)
        if known.job != self.digest:
            raise InputError(
                "is of a replay with another navigator or other options, or of another log: go on "
                "with the same, or begin anew with another file and folder",
                field="checkpoint",
                value=os.fspath(path),
            )
        return known

    def _checkpoint(
        self, path: Any, upto: float, forward: Forward, summary: Summary
    ) -> Callable[[], None]:
        """Return the job that writes a checkpoint of now, when all parts before it are written."""
        summary.late = dict(forward.late)
        counts = dataclasses.asdict(summary)
        point = Checkpoint(self.digest, upto, summary.parts, forward.kept(), counts)

        def write() -> None:
            self.parts.sync()
            point.write(path)

        return write

    def _step(
        self,
        forward: Forward,
        summary: Summary,
        writer: Background,
        *,
        last: bool,
        progress: Progress | None,
    ) -> None:
        while (made := forward.step(last=last)) is not None:
            writer.do(partial(self.parts.write, summary.parts, made.tables))
            summary.parts += 1
            summary.rows += len(made.tables["rows"]["t"])
            summary.samples += made.samples
            summary.fixes += made.fixes
            summary.rejected += made.rejected
            summary.restarts += made.restarts
            summary.log_likelihood += made.log_likelihood
            if progress is not None:
                progress(forward.reached)

    def _finish(self, forward: Forward, summary: Summary) -> None:
        self.parts.sync()
        forward.finish(summary.fixes, summary.rejected)
        summary.late = dict(forward.late)
        text = json.dumps({**self.note, **dataclasses.asdict(summary)}, indent=1)
        with replacing(self.out / "summary.json") as temporary:
            write_through(temporary, text.encode())
        if summary.late:
            lost = ", ".join(f"{n} of {name}" for name, n in summary.late.items())
            warn(f"rows came after their time had passed and were left out: {lost}")
        if summary.restarts:
            first = ", ".join(f"{t:.6g}" for t in summary.restarts[:5])
            more = " ..." if len(summary.restarts) > 5 else ""
            warn(
                f"the filter refused {self.options['max_rejected']} fixes running and started "
                f"again at t = {first}{more} s"
            )
