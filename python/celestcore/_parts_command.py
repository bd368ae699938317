"""`celestcore replay --parts`: a log of any length, in parts, and gone on with after a stop."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Collection
from pathlib import Path
from typing import TYPE_CHECKING, Any

from celestcore._files import check_output, replacing
from celestcore._optional import require
from celestcore.config import Settings
from celestcore.errors import InputError
from celestcore.formats import open_log
from celestcore.io import warn_left_out
from celestcore.replay import Summary, run

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarNavigator
    from celestcore.navigator import StarGyroNavigator


@dataclasses.dataclass(frozen=True)
class Parts:
    """What a replay in parts was asked for."""

    log: Path
    folder: Path
    checkpoint: Path | None = None
    resume: bool = False
    window: float | None = None
    every: int = 1
    config: Path | None = None
    filter: str | None = None
    gate: float | None = None
    smooth: bool = False
    json: str | None = None
    reading: dict[str, Any] = dataclasses.field(default_factory=dict)

    def check(self) -> None:
        """Refuse what cannot be written, before anything is computed."""
        if self.checkpoint is not None:
            check_output(self.checkpoint, "--checkpoint")
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
            summary = run(
                stream,
                _navigator(stream.sensors, settings.merged(options)),
                self.folder,
                window=self.window,
                every=self.every,
                smooth=self.smooth,
                checkpoint=self.checkpoint,
                resume=self.resume,
                progress=progress,
            )
            warn_left_out(stream)
            return summary

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
        # after a stop the counts are of all runs together, the time of the last one alone
        timed = not summary.resumed and summary.elapsed_s > 0.0
        what = "gyro samples" if summary.samples else "fixes"
        done = summary.samples or summary.fixes
        speed = f", {done / summary.elapsed_s:,.0f} {what}/s" if timed else ""
        out.append(f"{summary.elapsed_s:.1f} s{speed}")
        return out

    def write(self, summary: Summary) -> None:
        """Write the summary as JSON."""
        text = json.dumps(dataclasses.asdict(summary), indent=1)
        if self.json == "-":
            print(text)
        elif self.json is not None:
            with replacing(self.json) as temporary:
                temporary.write_text(text + "\n", encoding="utf-8")


def _navigator(names: Collection[str], settings: Settings) -> StarGyroNavigator | GnssStarNavigator:
    """Return the navigator that a replay of the log as a whole takes."""
    from celestcore import _gnss_replay

    if _gnss_replay.wanted_of(names, settings):
        return _gnss_replay.navigator_of(names, settings)
    return settings.navigator()


def replay_parts(
    paths: tuple[Path | None, Path | None, Path | None],
    how: dict[str, Any],
    more: dict[str, Any],
    others: dict[str, Any],
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
        summary = request.run(lambda t: status.update(f"replaying: t = {t:,.0f} s"))
    request.write(summary)
    for line in request.words(summary):
        console.print(line, soft_wrap=True)
    console.print(f"parts: {folder}", soft_wrap=True)
