"""`open_log`: a log of any format, read in chunks or in windows of time."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, BinaryIO

from celestcore._check import number
from celestcore._columns import parts_from_columns
from celestcore._epoch import epoch_string
from celestcore._toml import load_toml
from celestcore.config import Settings
from celestcore.errors import InputError, LogFormatError
from celestcore.formats._flow import Flow, Rules
from celestcore.formats._model import CHUNK_ROWS, ROW, Columns, Source, faults, name_of
from celestcore.formats._registry import Format, choose
from celestcore.formats._stamps import Stamps, by_sensor, epoch_of
from celestcore.formats._timeline import SensorReport, join
from celestcore.formats._windows import Ahead, Window, windows
from celestcore.log import SensorLog


class LogStream:
    """A log that is read as it is used; `open_log` makes it.

    Iterating gives pairs of a sensor's name and a chunk of its columns, float64, ``t`` first. The
    times of one sensor increase from chunk to chunk; chunks of different sensors come as the
    format has them. Every iteration begins at the beginning.

    Attributes
    ----------
    format : str
        Name of the format.
    epoch : str or None
        Where times count from.
    settings : dict
        What ``log.toml``, or the file itself, says.
    sensors : dict of str to tuple of str
        The sensors and their columns.
    reports : dict of str to SensorReport
        What was found in their times during the last pass.

    Examples
    --------
    >>> import celestcore as cc
    >>> with open_log(cc.sample_path("noaa20")) as stream:
    ...     rows = {name: 0 for name in stream.sensors}
    ...     for name, columns in stream:
    ...         rows[name] += len(columns["t"])
    >>> rows
    {'gnss': 7200, 'star': 7200}
    """

    def __init__(
        self, name: str, found: Format, source: Source, rules: Rules, settings: dict[str, Any]
    ) -> None:
        self.name, self.format = name, found.name
        self.epoch, self.settings = rules.epoch, settings
        self.sensors = {n: c for lane in source.lanes for n, c in lane.sensors.items()}
        self.reports = self._new_reports()
        self._source, self._found, self._rules = source, found, rules
        self._flows: list[Flow] = []
        self._ahead: Ahead[Window] | None = None

    def _new_reports(self) -> dict[str, SensorReport]:
        return {name: SensorReport() for name in self.sensors}

    def _pass(self, start: float | None = None) -> list[Flow]:
        self.close()
        self.reports = self._new_reports()
        given = (self._rules, self.name, self.reports, start)
        self._flows = [Flow(lane, *given) for lane in self._source.lanes]
        return self._flows

    def __iter__(self) -> Iterator[tuple[str, Columns]]:
        for flow in self._pass():
            while (pieces := flow.pull()) is not None:
                for sensor, several in pieces.items():
                    for columns in several:
                        yield sensor, {c: v for c, v in columns.items() if c != ROW}

    def windows(
        self, seconds: float, *, start: float | None = None, ahead: int = 1
    ) -> Iterator[Window]:
        """Go through all sensors side by side, a stretch of time at once.

        Memory holds a window or two and a chunk of each sensor, whatever the length of the log.
        Windows without rows are left out.

        Parameters
        ----------
        seconds : float
            Length of a window.
        start : float, optional
            Where the first window begins; rows before it are left out, by Parquet mostly without
            reading them. Without it windows begin at whole multiples of `seconds`.
        ahead : int
            How many windows are read in advance by a thread, while others are used; 0 for none.

        Yields
        ------
        Window

        Raises
        ------
        LogFormatError
            Where the file is damaged; the windows before that have been given.

        Examples
        --------
        >>> import celestcore as cc
        >>> with open_log(cc.sample_path("noaa20")) as stream:
        ...     counts = [len(w.tables["star"]["t"]) for w in stream.windows(600.0, start=0.0)]
        >>> counts[0], len(counts)
        (600, 12)
        """
        length = number(seconds, "seconds", above=0.0)
        first = None if start is None else number(start, "start")
        items = windows(self._pass(first), length, first, self.settings)
        if ahead < 1:
            return items
        self._ahead = Ahead(items, ahead)
        return iter(self._ahead)

    def _reading(self) -> dict[str, Any]:
        """Return how times are read, as far as it is not as usual; for what depends on it."""
        rules = self._rules
        stamps = {n: repr(s) for n, s in rules.stamps.items() if s != Stamps()}
        found: dict[str, Any] = {
            "reorder": rules.reorder,
            "jump": rules.jump,
            "stamps": stamps or None,
        }
        found["ranges"] = {n: list(r) for n, r in rules.ranges.items()} or None
        return {name: value for name, value in found.items() if value is not None}

    def _first(self, name: str) -> Columns:
        """Return the first rows of one sensor, nothing if it has none."""
        found: Columns = {}
        for flow in self._pass():
            while name in flow.lane.sensors and not found:
                pieces = flow.pull()
                if pieces is None:
                    break
                found = join(pieces[name]) if pieces.get(name) else {}
        self.close()
        return found

    def read(self) -> SensorLog:
        """Read everything into memory.

        Returns
        -------
        SensorLog

        Raises
        ------
        InputError
            If a value is wrong; names the file, the field, the row (of the file's data) and the
            value.

        Examples
        --------
        >>> import celestcore as cc
        >>> with open_log(cc.sample_path("fermi")) as stream:
        ...     stream.read()
        SensorLog('Fermi...
        """
        tables: dict[str, list[Columns]] = {}
        strict = self._rules.reorder is None
        for flow in self._pass():
            while (pieces := flow.pull()) is not None:
                for name, several in pieces.items():
                    tables.setdefault(name, []).extend(several)
        whole = {name: join(parts) for name, parts in tables.items() if parts}
        empty = [name for name in self.sensors if name not in whole]
        with faults(self.name):
            for name in empty if strict and self.format != "csv" else ():
                raise InputError(
                    "is empty; leave the sensor out if it has no samples", field=f"{name}.t"
                )
            if not whole:
                raise LogFormatError("holds no rows")
            return self._checked(whole)

    def _checked(self, whole: dict[str, Columns]) -> SensorLog:
        """Make the log; a row in an error becomes the row in the file."""
        rows = {name: columns.pop(ROW) for name, columns in whole.items() if ROW in columns}
        parts: dict[str, Any] = {}
        for name in list(whole):
            parts[name] = parts_from_columns(name, whole.pop(name))
        try:
            return SensorLog(epoch=self.epoch, settings=self.settings, **parts)
        except InputError as error:
            table = (error.field or "").partition(".")[0]
            if table in rows and error.row is not None:
                error.row = int(rows[table][error.row])
            raise

    def split(self) -> list[LogStream]:
        """Cut the log where its clocks jumped; it needs ``open_log(..., reorder=, jump=)``.

        Reads all times once to find the jumps.

        Returns
        -------
        list of LogStream
            One part more than there were jumps.

        Raises
        ------
        InputError
            If no `jump` was given, or sensors jumped differently often.

        Examples
        --------
        >>> import celestcore as cc
        >>> stream = open_log(cc.sample_path("noaa20"), reorder=0.0, jump=3600.0)
        >>> len(stream.split())
        1
        """
        if self._rules.jump is None:
            raise InputError("is needed to find where a clock jumped", field="jump")
        for _ in self:
            pass
        cuts = {name: [j.row for j in r.jumps] for name, r in self.reports.items()}
        counts = {name: r.jumped for name, r in self.reports.items()}
        if len(set(counts.values())) > 1 or max(counts.values()) > len(next(iter(cuts.values()))):
            found = ", ".join(f"{name} {count}" for name, count in counts.items())
            raise InputError(f"the sensors' clocks jumped differently often ({found})")
        parts = []
        for k in range(len(next(iter(cuts.values()))) + 1):
            ranges = {
                name: ([0, *rows][k], rows[k] if k < len(rows) else None)
                for name, rows in cuts.items()
            }
            rules = replace(self._rules, ranges=ranges)
            parts.append(LogStream(self.name, self._found, self._source, rules, self.settings))
        return parts

    def close(self) -> None:
        """Close the files of the pass that is under way.

        Examples
        --------
        >>> import celestcore as cc
        >>> open_log(cc.sample_path("fermi")).close()
        """
        if self._ahead is not None:
            self._ahead.stop()
            self._ahead = None
        for flow in self._flows:
            flow.close()
        self._flows = []

    def __enter__(self) -> LogStream:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def __repr__(self) -> str:
        return f"LogStream({self.name!r}, {self.format}: {', '.join(self.sensors)})"


def open_log(
    source: str | os.PathLike[str] | BinaryIO,
    *,
    format: str | None = None,  # noqa: A002 - what it is called everywhere
    chunk_rows: int = CHUNK_ROWS,
    reorder: float | None = None,
    jump: float | None = None,
    damaged: str = "raise",
    epoch: Any = None,
    stamps: Stamps | Mapping[str, Stamps] | None = None,
    **options: Any,
) -> LogStream:
    """Open a log of any known format, to be read piece by piece.

    Parameters
    ----------
    source : path or binary file
        What to read. A TOML file ``log.toml`` (directory) or of the same name (file) is read too.
    format : str, optional
        A name that ``celestcore formats`` lists; found by itself for a path, needed for a file
        object.
    chunk_rows : int
        About so many rows of one sensor come at once.
    reorder : float, optional
        Rows that come up to so many seconds late are put in their place; those that come later or
        repeat a time are left out and counted in `LogStream.reports`. Without it such a row is an
        error.
    jump : float, optional
        With `reorder`: steps of more than so many seconds are reported as jumps of the clock, or,
        where it comes back within three rows, left out as strays.
    damaged : {"raise", "keep"}
        Whether damage amid a file is an error, or the end of what is kept, with a warning.
    epoch : str, datetime or astropy Time, optional
        Where times count from; wins over the log's. Where times are absolute and nothing else says
        it, it becomes the first whole second.
    stamps : Stamps or dict of str to Stamps, optional
        How the times of all sensors, or of some, count.
    **options
        What the format takes, see `celestcore.formats`.

    Returns
    -------
    LogStream

    Raises
    ------
    LogFormatError
        If the file cannot be read or columns are missing; lists what was found.
    MissingDependencyError
        If the package that the format needs is not installed; names it.

    Examples
    --------
    >>> import celestcore as cc
    >>> open_log(cc.sample_path("noaa20")).sensors["gnss"]
    ('t', 'x', 'y', 'z', 'vx', 'vy', 'vz')
    """
    rules = _rules(chunk_rows, reorder, jump, damaged)
    where: Any = Path(source) if isinstance(source, str | os.PathLike) else source
    found = choose(where, format)
    name = name_of(where)
    if isinstance(where, Path) and not where.exists():
        raise LogFormatError("there is no such file or directory", source=name)
    with faults(name):
        assert found.read is not None
        log = found.read(where, **_with_kind(found, options))
        settings = _settings(where, log)
        given = {
            **log.stamps,
            **by_sensor(stamps, [n for lane in log.lanes for n in lane.sensors]),
        }
        said = settings.get("log", {}).get("epoch") if epoch is None else epoch
        rules = replace(rules, epoch=epoch_string(said), stamps=given)
        if rules.epoch is None:
            rules = replace(rules, epoch=_first_epoch(log, rules))
    return LogStream(name, found, log, rules, settings)


def _rules(chunk_rows: int, reorder: float | None, jump: float | None, damaged: str) -> Rules:
    if damaged not in ("raise", "keep"):
        raise InputError("must be 'raise' or 'keep'", field="damaged", value=damaged)
    if jump is not None and reorder is None:
        raise InputError("goes with reorder= only, which may be 0", field="jump")
    return Rules(
        chunk_rows=int(number(chunk_rows, "chunk_rows", at_least=1.0)),
        reorder=None if reorder is None else number(reorder, "reorder", at_least=0.0),
        jump=None if jump is None else number(jump, "jump", above=0.0),
        keep_damaged=damaged == "keep",
    )


def _with_kind(found: Format, options: dict[str, Any]) -> dict[str, Any]:
    return {**options, "kind": found.name} if found.name in ("aem", "oem") else options


def _settings(where: Any, log: Source) -> dict[str, Any]:
    """Return the TOML file's settings over what the log says of itself."""
    settings = {name: dict(table) for name, table in log.settings.items()}
    if not isinstance(where, Path):
        return settings
    sidecar = where / "log.toml" if where.is_dir() else where.with_suffix(".toml")
    if not sidecar.is_file():
        return settings
    beside = load_toml(sidecar)
    try:
        Settings.from_dict(beside)
    except InputError as error:
        raise error.located(str(sidecar)) from None
    for name, table in beside.items():
        settings[name] = {**settings.get(name, {}), **table}
    return settings


def _first_epoch(log: Source, rules: Rules) -> str | None:
    """Return the first whole second of a log whose times are absolute; None if they are not."""
    absolute = {n for n, s in rules.stamps.items() if s.since is not None} | set(log.calendar)
    texts = []
    for lane in log.lanes:
        if absolute.isdisjoint(lane.sensors):
            continue
        chunks = lane.read(min(rules.chunk_rows, 1024))
        for name, columns in (next(chunks, None) or {}).items():
            if name in absolute and len(columns["t"]):
                texts.append(epoch_of(columns["t"], rules.stamps.get(name, Stamps())))
        close = getattr(chunks, "close", None)
        if close is not None:
            close()
    return min(texts, default=None)
