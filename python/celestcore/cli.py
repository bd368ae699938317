"""The command line: ``celestcore replay``, ``info``, ``campaign``, ``reproduce`` and ``bench``.

This module needs numpy only; the commands themselves (typer, rich) are in `_commands`.
"""

from __future__ import annotations

import json
import os
import sys
import warnings
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from celestcore._files import check_outputs, replacing
from celestcore._optional import require
from celestcore.errors import CelestcoreError, CelestcoreWarning, InputError
from celestcore.units import ARCSEC, DEG_PER_HOUR_PER_SQRT_HOUR, DEG_PER_SQRT_HOUR

if TYPE_CHECKING:
    from celestcore._gnss_replay import GnssReplay
    from celestcore.analysis import WithheldDrift
    from celestcore.config import Settings
    from celestcore.log import SensorLog
    from celestcore.solution import Solution

STDOUT = "-"
ENDINGS = (".parquet", ".npz", ".csv")
INTERRUPTED = 130
GAP_STEPS = 3.0  # in medians: longer steps count as gaps in `info`
Progress = Callable[[int, int], None]


def main(arguments: list[str] | None = None) -> int:
    """Run the command line and return its exit code: 0, 2 for an error, 130 for Ctrl-C.

    Parameters
    ----------
    arguments : list of str, optional
        Without the program's name; those of the process by default.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("always", CelestcoreWarning)
        warnings.showwarning = _show_warning
        try:
            for package in ("typer", "rich"):
                require(package, extra="cli", what="the command line")
            code = _app()(args=arguments, prog_name="celestcore", standalone_mode=False)
            return _interrupted() if code == INTERRUPTED else int(code or 0)
        except CelestcoreError as error:
            return _fail(str(error), getattr(error, "exit_code", 2))
        except BrokenPipeError:
            os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
            return 0
        except OSError as error:
            return _fail(f"{error.filename or ''}: {error.strerror or error}".lstrip(": "))
        except MemoryError:
            return _fail("not enough memory: thin the output with --period, or split the log")
        except KeyboardInterrupt:
            return _interrupted()
        except Exception as error:
            return _usage_error(error)


def _app() -> Any:
    """Return the typer application as a click command."""
    import typer

    from celestcore._commands import app

    return typer.main.get_command(app)


def _usage_error(error: Exception) -> int:
    """Report a wrong option in one line; raise again what is a bug in celestcore."""
    if type(error).__name__ == "Abort":
        return _interrupted()
    describe = getattr(error, "format_message", None)
    if describe is None:
        raise error
    context = getattr(error, "ctx", None)
    path = getattr(context, "command_path", "celestcore")
    return _fail(f"{str(describe()).rstrip('.')} (see '{path} --help')")


def _interrupted() -> int:
    return _fail("interrupted: nothing was written", INTERRUPTED)


def _fail(message: str, code: int = 2) -> int:
    print("error: " + " ".join(message.split()), file=sys.stderr)
    return code


def _show_warning(
    message: Warning | str,
    category: type[Warning],
    filename: str,
    lineno: int,
    file: TextIO | None = None,
    line: str | None = None,
) -> None:
    if issubclass(category, CelestcoreWarning):
        print(f"warning: {message}", file=sys.stderr)


@dataclass(frozen=True)
class Replay:
    """What ``celestcore replay`` was asked for; `check` before `run`, `write` at the end."""

    log: Path | None = None
    sample: str | None = None
    filter: str | None = None
    config: Path | None = None
    gate: float | None = None
    period: float | None = None
    withhold: float | None = None
    output: Path | None = None
    report: Path | None = None
    json: str | None = None
    smooth: bool = False
    reading: Mapping[str, Any] = field(default_factory=dict)

    def check(self) -> None:
        """Refuse what cannot be written, before anything is computed.

        Raises
        ------
        InputError
            If a directory does not exist, an ending is unknown, or files would overwrite
            each other or the log.
        MissingDependencyError
            If a package that an output needs is not installed.
        """
        check_outputs(self._outputs(), (self.log, self.config))
        if self.output is not None:
            ending = self.output.suffix.lower()
            if ending not in ENDINGS:
                raise InputError(
                    f"must end in .parquet (.npz or .csv, too, for logs with GNSS fixes), not "
                    f"{self.output}",
                    field="--output",
                )
            if ending == ".parquet":
                require("pyarrow.parquet", extra="parquet", what="writing Parquet")
        if self.report is not None:
            from celestcore.report import kind

            if kind(self.report) == ".png":
                require("matplotlib.figure", extra="plot", what="the report's pictures")

    def _outputs(self) -> list[tuple[str, Path]]:
        named = (
            ("--output", self.output),
            ("--report", self.report),
            ("--json", None if self.json in (None, STDOUT) else Path(str(self.json))),
        )
        return [(option, path) for option, path in named if path is not None]

    def load(self) -> tuple[SensorLog, Settings]:
        """Read the log and its settings; --config wins over them, options win over both."""
        from celestcore.config import Settings

        log = load_log(self.log, self.sample, self.reading)
        if log.gyro is None and log.gnss is None:
            holds = ", ".join(log.tables)
            raise InputError(
                f"this log has neither a gyro nor GNSS fixes to replay; it holds {holds}",
                field="gyro",
            )
        settings = Settings.from_log(log)
        if self.config is not None:
            settings = settings.merged(Settings.from_toml(self.config))
        options: dict[str, Any] = {}
        if self.filter is not None:
            options["filter"] = {"kind": self.filter}
        if self.gate is not None:
            options["gate"] = {"probability": self.gate}
        settings = settings.merged(options)
        if not self.by_gnss(log, settings):
            self._check_by_gyro()
        return log, settings

    @staticmethod
    def by_gnss(log: SensorLog, settings: Settings) -> bool:
        """Tell whether the log is one for the GNSS and star navigator."""
        from celestcore import _gnss_replay

        return _gnss_replay.wanted(log, settings)

    def _check_by_gyro(self) -> None:
        """Refuse what only a log with GNSS fixes can do."""
        if self.smooth and self.period is not None:
            raise InputError(
                "does not go with --smooth, which writes at gyro samples", field="--period"
            )
        if self.output is not None and self.output.suffix.lower() != ".parquet":
            raise InputError(f"must end in .parquet, not {self.output}", field="--output")

    def run_gnss(
        self, log: SensorLog, settings: Settings, progress: Progress | None = None
    ) -> GnssReplay:
        """Run the GNSS and star navigator and its tests."""
        from celestcore import _gnss_replay

        return _gnss_replay.run(
            log,
            settings,
            smooth=self.smooth,
            period=self.period,
            withhold=self.withhold,
            progress=progress,
        )

    def run(self, log: SensorLog, settings: Settings, progress: Progress | None = None) -> Solution:
        """Run the filter over the log, and back over it if asked to."""
        nav = settings.navigator()
        if self.smooth:
            return nav.smooth(log, sigma0=settings.sigma0(), progress=progress)
        return nav.run(log, sigma0=settings.sigma0(), period=self.period, progress=progress)

    def drift(self, log: SensorLog, settings: Settings) -> WithheldDrift | None:
        """Run the withheld-window test, if it was asked for."""
        if self.withhold is None:
            return None
        from celestcore.analysis import withheld_drift

        return withheld_drift(settings.navigator(), log, window=self.withhold)

    def write(
        self,
        solution: Solution,
        result: dict[str, Any],
        *,
        drift: WithheldDrift | None = None,
        settings: dict[str, str],
        command: str,
    ) -> None:
        """Write solution, report and summary: all or none appear."""

        def report(path: Path) -> None:
            from celestcore.report import write_report

            write_report(path, solution, result, drift=drift, settings=settings, command=command)

        self._put({"--output": solution.to_parquet, "--report": report}, result)

    def write_gnss(
        self, replay: GnssReplay, log: SensorLog, result: dict[str, Any], command: str
    ) -> None:
        """Write solution, report and summary of a log with GNSS fixes: all or none appear."""
        from celestcore._gnss_replay import write_solution

        def report(path: Path) -> None:
            from celestcore._gnss_report import write_report

            write_report(path, replay, result, command=command)

        self._put(
            {"--output": lambda path: write_solution(path, replay.output, log), "--report": report},
            result,
        )

    def _put(self, writers: dict[str, Callable[[Path], None]], result: dict[str, Any]) -> None:
        """Write all files beside their places first, then rename them."""
        text = json.dumps(result, indent=2, allow_nan=False) + "\n"
        with ExitStack() as stack:
            ready = {name: stack.enter_context(replacing(p)) for name, p in self._outputs()}
            for name, write in writers.items():
                if name in ready:
                    write(ready[name])
            if "--json" in ready:
                ready["--json"].write_text(text, encoding="utf-8")
        if self.json == STDOUT:
            sys.stdout.write(text)

    def written(self) -> list[tuple[str, Path]]:
        """Return what each file holds, and its name."""
        names = {"--output": "solution", "--report": "report", "--json": "summary"}
        return [(names[option], path) for option, path in self._outputs()]


def load_log(
    log: Path | None, sample: str | None, reading: Mapping[str, Any] | None = None
) -> SensorLog:
    """Read a log by path, as `read_log` does, or one that celestcore ships by name.

    Raises
    ------
    InputError
        If both or neither are given, the sample is unknown, or it is to be read in another way.
    """
    if (log is None) == (sample is None):
        raise InputError("give either a LOG or --sample NAME (for example --sample fermi)")
    if sample is not None:
        if reading:
            raise InputError(
                f"goes with a LOG: how the sample is read ({', '.join(reading)}) is known",
                field="--sample",
                value=sample,
            )
        from celestcore.samples import sample as load_sample

        return load_sample(sample)
    from celestcore.io import read_log

    assert log is not None
    return read_log(log, **(reading or {}))


def describe_log(log: SensorLog) -> dict[str, Any]:
    """Return what a log holds, ready for JSON; what ``celestcore info --json`` writes.

    Parameters
    ----------
    log : SensorLog

    Returns
    -------
    dict
        title, epoch, frames, span_s, settings, and for each table rows, missing, t_first,
        t_last, the median and largest step in s (None with fewer than two rows), and
        gaps, the number of steps longer than three medians.
    """
    tables: dict[str, Any] = {}
    for name, table in log.tables.items():
        steps = np.diff(table.t)
        tables[name] = {
            "rows": len(table),
            "missing": table.missing,
            "t_first": float(table.t[0]) if len(table) else None,
            "t_last": float(table.t[-1]) if len(table) else None,
            "step_median_s": float(np.median(steps)) if len(steps) else None,
            "step_max_s": float(np.max(steps)) if len(steps) else None,
            "gaps": int(np.sum(steps > GAP_STEPS * np.median(steps))) if len(steps) else 0,
        }
    first, last = log.span
    return {
        "title": log.title,
        "epoch": log.epoch,
        "frames": log.frames,
        "span_s": last - first,
        "settings": log.settings,
        "tables": tables,
    }


def describe_settings(settings: Settings) -> dict[str, str]:
    """Return the noise of a run, and how far fixes are believed, in words, for tables."""
    gyro = settings.gyro()
    out = {
        "Gyro noise": f"angle random walk {gyro.arw / ARCSEC:.3g} arcsec/√s "
        f"({gyro.arw / DEG_PER_SQRT_HOUR:.3g} deg/√h), rate random walk "
        f"{gyro.rrw / DEG_PER_HOUR_PER_SQRT_HOUR:.3g} deg/h/√h"
    }
    for name, camera in settings.stars().items():
        out[f"Noise of {name}"] = _sigma_words(camera.sigma)
    for name, sensor in settings.vectors().items():
        out[f"Noise of vector_{name}"] = _sigma_words(sensor.sigma)
    return out | _belief_words(settings)


def _belief_words(settings: Settings) -> dict[str, str]:
    gate, table = settings.gate(), settings.tables.get("gate", {})
    huber, student, adaptive = (table.get(name) for name in ("huber", "student_t", "adaptive"))
    weighed = huber is not None or student is not None
    out = {"Gate": f"none: every fix is used{', doubtful ones with less weight' * weighed}"}
    if gate is not None:
        out["Gate"] = f"rejects fixes outside {100.0 * gate:.6g} % of the chi-square law"
    if huber is not None:
        out["Doubtful fixes"] = f"Huber's weights beyond {huber:.6g} sigmas"
    if student is not None:
        out["Doubtful fixes"] = f"Student's weights with {student:.6g} degrees of freedom"
    if adaptive is not None:
        out["Noise"] = f"found as the filter runs, from about {adaptive:.6g} fixes"
    return out


def _sigma_words(sigma: Any) -> str:
    if sigma is None:
        return "as given with each fix"
    values = np.atleast_1d(np.asarray(sigma, dtype=float)) / ARCSEC
    return f"{' / '.join(f'{value:.3g}' for value in values)} arcsec (1 sigma)"
