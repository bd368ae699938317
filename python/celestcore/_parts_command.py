"""`celestcore replay --parts`: a log of any length, in parts, and gone on with after a stop."""

from __future__ import annotations

import dataclasses
import errno
import json
import os
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from celestcore._files import check_outputs, replacing
from celestcore._interrupted import Interrupted
from celestcore._optional import require
from celestcore.config import Settings
from celestcore.errors import CelestcoreError, InputError
from celestcore.formats import open_log
from celestcore.io import warn_left_out
from celestcore.navigator import StarGyroNavigator
from celestcore.replay import Summary, report, run
from celestcore.replay._report import check as check_report

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarNavigator


@dataclasses.dataclass
class Parts:
    """What a replay in parts was asked for."""

    log: Path
    folder: Path
    checkpoint: Path | None = None
    resume: bool = False
    window: float | None = None
    every: int = 1
    interval: float = 30.0
    config: Path | None = None
    filter: str | None = None
    gate: float | None = None
    smooth: bool = False
    json: str | None = None
    reading: dict[str, Any] = dataclasses.field(default_factory=dict)
    report: Path | None = None
    title: str = ""
    told: dict[str, str] = dataclasses.field(default_factory=dict)
    """Noise and gate of the run, in words."""
    disorder: dict[str, str] = dataclasses.field(default_factory=dict)
    """What a reader that puts rows in order made of those of each sensor, in words."""

    def check(self) -> None:
        """Refuse what cannot be written, before anything is computed."""
        if self.report is not None:
            check_report(self.report, "--report")
        json_file = None if self.json in (None, "-") else Path(str(self.json))
        outputs = (
            ("--checkpoint", self.checkpoint),
            ("--report", self.report),
            ("--json", json_file),
        )
        check_outputs(outputs, (self.log, self.config))
        folder = Path(os.path.realpath(self.folder))
        real = Path(os.path.realpath(self.log))
        if folder == real or real in folder.parents:
            raise InputError(f"would write into the input {self.log}", field="--parts")
        if self.resume and self.checkpoint is None:
            raise InputError("needs --checkpoint FILE, to go on from", field="--resume")
        if not self.folder.absolute().parent.is_dir():
            raise InputError(
                f"the directory {self.folder.absolute().parent} does not exist: create it first",
                field="--parts",
            )

    def run(self, progress: Any = None) -> Summary:
        """Replay the log."""
        with open_log(self.log, **self.reading) as stream:
            settings = Settings.from_dict(stream.settings)
            if self.config is not None:
                settings = settings.merged(Settings.from_toml(self.config))
            options: dict[str, Any] = {}
            if self.filter is not None:
                options["filter"] = {"kind": self.filter}
            if self.gate is not None:
                options["gate"] = {"probability": self.gate}
            settings = settings.merged(options)
            navigator, self.told = _navigator(stream.sensors, settings)
            attitudes = isinstance(navigator, StarGyroNavigator)
            if self.report is not None and not attitudes:
                raise InputError(
                    "tells of attitudes from a gyro and star cameras; without --parts it tells of "
                    "logs with GNSS fixes, too",
                    field="--report",
                )
            self.title = str(stream.settings.get("log", {}).get("title") or self.log.name)
            made = run(
                stream,
                navigator,
                self.folder,
                window=self.window,
                every=self.every,
                smooth=self.smooth,
                checkpoint=self.checkpoint,
                interval=self.interval,
                resume=self.resume,
                progress=progress,
                sigma0=settings.sigma0() if attitudes else None,
            )
            warn_left_out(stream)
            for name, found in stream.reports.items():
                if found.troubles:
                    counts = (f"{n:,} {kind}" for kind, n in found.troubles.items())
                    since = " since it went on" if made.resumed else ""
                    self.disorder[f"Rows of {name} out of order{since}"] = ", ".join(counts)
            return made

    def left(self) -> str:
        """Return what there is after a stop."""
        there = f"the parts so far are in {self.folder}"
        if self.checkpoint is None or not self.checkpoint.exists():
            return f"{there}; with --checkpoint FILE a replay can be gone on with"
        return f"{there}; the same command with --resume goes on"

    def words(self, summary: Summary) -> list[str]:
        """Return what happened as lines for people."""
        samples = f"{summary.samples:,} gyro samples and " if summary.samples else ""
        out = [
            f"{samples}{summary.fixes:,} fixes, {summary.rejected:,} "
            f"refused; {summary.rows:,} rows in {summary.parts:,} parts"
        ]
        if summary.resumed:
            out.append("went on from the checkpoint")
        if summary.restarts:
            first = ", ".join(f"{t:.6g}" for t in summary.restarts[:5])
            more = " ..." if len(summary.restarts) > 5 else ""
            out.append(f"started again, lost, at t = {first}{more} s")
        if summary.late:
            lost = ", ".join(f"{n:,} of {name}" for name, n in summary.late.items())
            out.append(f"too late for their time and left out: {lost}")
        out += [f"{name.lower()}: {counted}" for name, counted in self.disorder.items()]
        # after a stop the counts are of all runs together, the time of the last one alone
        timed = not summary.resumed and summary.elapsed_s > 0.0
        what = "gyro samples" if summary.samples else "fixes"
        done = summary.samples or summary.fixes
        speed = f", {done / summary.elapsed_s:,.0f} {what}/s" if timed else ""
        out.append(f"{summary.elapsed_s:.1f} s{speed}")
        return out

    def write(self, summary: Summary, command: str) -> None:
        """Write the report and the summary as JSON."""
        if self.report is not None:
            more = {**self.told, **self.disorder}
            report(self.folder, self.report, title=self.title, settings=more, command=command)
        text = json.dumps(dataclasses.asdict(summary), indent=1)
        if self.json == "-":
            print(text)
        elif self.json is not None:
            with replacing(self.json) as temporary:
                temporary.write_text(text + "\n", encoding="utf-8")


def _navigator(
    names: Collection[str], settings: Settings
) -> tuple[StarGyroNavigator | GnssStarNavigator, dict[str, str]]:
    """Return the navigator that a replay of the log as a whole takes, and its noise in words."""
    from celestcore import _gnss_replay
    from celestcore._gnss_words import settings_words
    from celestcore.cli import describe_settings

    if _gnss_replay.wanted_of(names, settings):
        navigator = _gnss_replay.navigator_of(names, settings)
        return navigator, settings_words(navigator)
    return settings.navigator(), describe_settings(settings)


def replay_parts(
    paths: tuple[Path | None, Path | None, Path | None],
    how: dict[str, Any],
    more: dict[str, Any],
    others: dict[str, Any],
    command: str,
) -> None:
    """Run ``celestcore replay --parts`` and say what happened."""
    log, folder, checkpoint = paths
    for option, value in others.items():
        if value is not None:
            raise InputError("does not go with --parts, which writes parts alone", field=option)
    if folder is None:
        raise InputError("is needed with --checkpoint: a folder for the results", field="--parts")
    if log is None:
        raise InputError("give a LOG to replay in parts", field="LOG")
    request = Parts(log=log, folder=folder, checkpoint=checkpoint, **how, **more)
    request.check()
    rich = require("rich.console", extra="cli", what="the command line")
    console = rich.Console(stderr=more["json"] == "-", highlight=False, markup=False)
    with console.status("replaying") as status:
        try:
            summary = request.run(lambda t: status.update(f"replaying: t = {t:,.0f} s"))
        except KeyboardInterrupt:
            raise Interrupted(f"interrupted: {request.left()}") from None
        except OSError as error:
            if error.errno != errno.ENOSPC:
                raise
            raise CelestcoreError(f"the disk is full: {request.left()}") from error
    request.write(summary, command)
    for line in request.words(summary):
        console.print(line, soft_wrap=True)
    console.print(f"parts: {folder}", soft_wrap=True)
    if request.report is not None:
        console.print(f"report: {request.report}", soft_wrap=True)
