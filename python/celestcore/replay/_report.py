"""A replay in parts as one HTML page: what happened and when, in words, numbers and plots."""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from celestcore import _attitude_panels as show
from celestcore import _findings, _page, _sensor_panels
from celestcore import report as base
from celestcore._curves import time_axis
from celestcore._files import check_output, replacing
from celestcore._fixes import Fixes
from celestcore._page import marked
from celestcore._panels import Panel, Section, Times
from celestcore.errors import InputError
from celestcore.replay._digest import Digest, digest
from celestcore.replay._happened import events, when
from celestcore.replay._tally import scores
from celestcore.replay._thin import Columns
from celestcore.solution import Array, package_version
from celestcore.summary import _plain, headline, spell_time
from celestcore.units import ARCSEC

STATES = ("fine", "nis_high", "nis_low", "rejecting", "no_fixes", "few")
SHOWN = 60
THINNED = (
    "A replay in parts may be longer than memory: drawn are the lowest and the highest values of "
    "each stretch, and all counts and shares are of all measurements. Zooming in shows no more "
    "than these; the parts have every row."
)
LOST = (
    "Wrong fixes for a while, a gyro that changed at once, a clock that jumped or a manoeuvre "
    "beyond the gyro's range do that: see what happened just before."
)
LATE = (
    "A file whose rows are not in order of time, or a sensor that is slower than the window does "
    "that: sort the log, or take longer windows."
)


def report(
    folder: str | os.PathLike[str],
    path: str | os.PathLike[str],
    *,
    title: str | None = None,
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
) -> dict[str, Any]:
    """Write a report of what a replay has written: one HTML page that needs nothing beside it.

    The parts are read one after the other in bounded memory; of a replay that has not ended, the
    parts so far.

    Parameters
    ----------
    folder : path
        The replay's `out`.
    path : path
        Of the page, ends in .html. It appears whole or not at all.
    title : str, optional
        Of the page.
    settings : dict of str to str, optional
        What the run was told (noise, gate, ...), shown as given.
    command : str, optional
        The command that made it, to be shown.

    Returns
    -------
    dict
        The numbers of the page, JSON-ready, as the page itself carries them: as
        `celestcore.summary.summary` and ``replay`` (`summary.json`, or None before the end),
        ``events`` (what happened, in order of time) and ``parts`` that stand out.

    Raises
    ------
    InputError
        If there is no such output, it has no complete part, or the page cannot be written there.
    MissingDependencyError
        Without pyarrow.

    Examples
    --------
    >>> import celestcore as cc
    >>> from tempfile import TemporaryDirectory
    >>> log = cc.sample("fermi")
    >>> nav = cc.Settings.from_log(log).navigator()
    >>> with TemporaryDirectory() as out:
    ...     done = cc.replay.run(log, nav, f"{out}/parts", every=10)
    ...     told = cc.replay.report(f"{out}/parts", f"{out}/report.html", title="Fermi")
    >>> told["replay"]["samples"] == done.samples
    True
    """
    check(path)
    found = digest(folder)
    result = summary(found, title)
    text = page(found, result, folder=os.fspath(folder), settings=settings, command=command)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")
    return result


def check(path: str | os.PathLike[str], field: str = "path") -> None:
    """Raise `InputError` if a report cannot be written there."""
    if Path(path).suffix.lower() != ".html":
        raise InputError(
            "a report of a replay in parts is a page: let its name end in .html",
            field=field,
            value=os.fspath(path),
        )
    check_output(path, field)


def summary(found: Digest, title: str | None = None) -> dict[str, Any]:
    """Return what came out of a replay in parts, JSON-ready; see `report`."""
    done = found.summary or {}
    tallies = found.tallies
    sensors = [tally.judged(STATES) for tally in tallies]
    stars = [tally for tally in tallies if tally.usual.dof == 3] or tallies[:1]
    good = sum(tally.accepted for tally in stars)
    full = bool(stars) and all(tally.usual.sigma is not None for tally in stars)
    used = sum(tally.accepted for tally in tallies)
    counts = {
        "rows": found.count,
        "parts": len(found.edge) - 1,
        "samples": done.get("samples"),
        "fixes": done.get("fixes", sum(tally.fixes for tally in tallies)),
        "accepted": used,
        "rejected": done.get("rejected", sum(tally.fixes - tally.accepted for tally in tallies)),
        "gaps": len(found.gaps),
        "restarts": len(found.restarts),
        "late": sum(done.get("late", {}).values()),
    }
    out: dict[str, Any] = {
        "log": title,
        "filter": found.note.get("filter", ""),
        "smoothed": bool(found.note.get("options", {}).get("smooth", False)),
        "gate": found.note.get("gate"),
        "version": package_version(),
        "counts": counts,
        "span_s": float(found.edge[-1] - found.edge[0]),
        "innovation": scores(
            np.sum([t.square for t in stars], axis=0) if full else None,
            good,
            sum(t.nis for t in tallies),
            sum(t.accepted * t.usual.dof for t in tallies),
            sum(t.inside_95 for t in tallies),
        ),
        "final": _final(found.even),
        "sensors": sensors,
        "replay": found.summary,
        "events": events(found),
        "parts": [vars(odd) for odd in found.odd],
        "parts_in_all": found.odd_in_all,
    }
    if used != good:  # NIS are of all sensors, the innovations of cameras alone
        inn = out["innovation"]
        inn["nis_mean"] = sum(t.nis for t in tallies) / max(used, 1)
        inn["inside_95"] = sum(t.inside_95 for t in tallies) / max(used, 1)
    out["findings"] = _findings.ranked(list(_found(found, out)), judged=used > 0)
    plain: dict[str, Any] = _plain(out)
    return plain


def _final(rows: Columns) -> dict[str, Any]:
    last = {name: float(column[-1]) for name, column in rows.items()}
    return {
        "t": last["t"],
        "q": [last[f"q{k}"] for k in "wxyz"],
        "bias": [last[f"b{k}"] for k in "xyz"],
        "sigma": [last[f"s_{k}"] for k in ("ax", "ay", "az", "bx", "by", "bz")],
    }


def _found(found: Digest, out: Mapping[str, Any]) -> Iterator[_findings.Finding]:
    """Yield what gives cause to look at."""
    yield from _findings.of_restarts(found.restarts, "filter", LOST)
    yield from _findings.of_rejections(out["counts"], out["gate"])
    yield from _findings.of_sensors(out["sensors"])
    yield from _findings.of_gaps(found.gaps)
    even = found.even
    bias, sigma = _stacked(even, ("bx", "by", "bz")), _stacked(even, ("s_bx", "s_by", "s_bz"))
    yield from _findings.of_bias(even["t"], bias, sigma)
    late = (found.summary or {}).get("late", {})
    if late:
        names = ", ".join(f"{n:,} of {name}" for name, n in late.items())
        words = f"After their time had passed came, and were left out: {names}."
        yield _findings.finding("look", "late", "Rows that came too late", words, LATE)
    if found.summary is None:
        words = f"{out['counts']['parts']:,} parts are complete; this page is of them."
        advice = "Go on from the checkpoint, and write the report again."
        yield _findings.finding("look", "not ended", "The replay has not ended", words, advice)


def page(
    found: Digest,
    result: Mapping[str, Any],
    *,
    folder: str = "",
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
) -> str:
    """Return the report as HTML text."""
    title = result["log"] or "A replay in parts"
    first, last = float(found.edge[0]), float(found.edge[-1])
    epoch = found.note.get("epoch")
    axis = time_axis(found.edge, epoch)
    times = Times(axis, first, last, epoch, found.gaps, tuple(found.restarts))
    fixes = [tally.drawn() for tally in found.tallies]
    panels: list[Panel] = []
    again = f"{_page.MARKS} " if found.restarts else ""
    parts = [
        _cards(result),
        _page.findings(result, times),
        _happened(result, times),
        "<h2>What was run</h2>",
        _run_table(found, result, folder, settings, command),
        "<h2>What came out</h2>",
        base.sensor_table(result) if fixes else "<p>Measurements were not kept.</p>",
        base.final_table(result),
        "<h2>Over time</h2>",
        f'<p class="note">{escape(axis.label)}. {escape(_page.HELP)} {escape(again + THINNED)}</p>',
        *_page.sections(_sections(found, fixes, times, result["smoothed"]), panels),
        _odd_parts(result, times),
        _page.noise_table(result),
        base.gap_table(found.gaps),
        base.footer({}, result),
    ]
    return _page.document(title, _lead(result), parts, panels, times, result, base.STYLE)


def _lead(result: Mapping[str, Any]) -> str:
    counts = result["counts"]
    if result["replay"] is None:
        return (
            f"Not ended yet: {counts['parts']:,} parts, {spell_time(result['span_s'])}, "
            f"{counts['fixes']:,} measurements."
        )
    again = counts["restarts"]
    often = "once" if again == 1 else f"{again:,} times"
    more = f" It lost its way and started again {often}." if again else ""
    return headline(dict(result)) + more


def _sections(found: Digest, fixes: list[Fixes], times: Times, smoothed: bool) -> Iterator[Section]:
    rows, even = found.rows, found.even
    t = rows["t"]
    sigma = _stacked(rows, ("s_ax", "s_ay", "s_az"))
    q = _stacked(rows, ("qw", "qx", "qy", "qz"))
    yield show.attitude(t, q, sigma, "the inertial frame")
    yield show.error(t, sigma, "smoother" if smoothed else "filter")
    yield show.rates(t, _stacked(rows, ("wx", "wy", "wz")))
    names = (("bx", "by", "bz"), ("s_bx", "s_by", "s_bz"))
    bias, sigma = (_stacked(rows, n) for n in names)
    yield show.bias(t, bias, sigma, calm=(_stacked(even, names[0]), _stacked(even, names[1])))
    lanes = _page.lanes(fixes, times)
    if not fixes:
        yield Section("How the sensors fared", "Measurements were not kept.", name="health")
        return
    yield _sensor_panels.health(fixes, times.first, times.last, lanes)
    if any(each.innovation is not None for each in fixes):
        yield _sensor_panels.innovations(fixes)
    yield _sensor_panels.nis(fixes)


def _stacked(columns: Columns, names: tuple[str, ...]) -> Array:
    return np.stack([columns[name] for name in names], axis=1)


def _cards(result: Mapping[str, Any]) -> str:
    size = float(np.sqrt(np.sum(np.square(result["final"]["sigma"][:3])))) / ARCSEC
    return _page.cards(
        [
            (marked(result, "counts.samples"), "gyro samples"),
            (marked(result, "counts.accepted"), "fixes used"),
            (marked(result, "counts.rejected"), "fixes rejected"),
            (marked(result, "counts.restarts"), "times started again"),
            (marked(result, "counts.gaps"), "gyro gaps"),
            (_page.number(size, "″"), "expected error at the end (1 sigma)"),
        ]
    )


def _happened(result: Mapping[str, Any], times: Times) -> str:
    """Return what happened in order of time, with buttons that show when."""
    every = result["events"]
    if not every:
        return "<h2>What happened</h2><p>No gap, no silence, nothing refused for long.</p>"
    shown = sorted(every, key=lambda e: -e["weight"])[:SHOWN]
    shown.sort(key=lambda e: (e["begin"], e["end"]))
    items = []
    for event in shown:
        a, b = (f"{times.place(event[key]):.9g}" for key in ("begin", "end"))
        items.append(
            f"<li><b>{times.place(event['begin']):.3f} {times.unit}"
            f"<small>{escape(times.date(event['begin']))}</small></b>"
            f"<span>{escape(event['words'])}</span>"
            f'<button data-from="{a}" data-to="{b}" data-goto="health">show when</button></li>'
        )
    more = f", the {SHOWN} gravest of {len(every):,}" if len(every) > SHOWN else ""
    heading = f"<h2>What happened, in order of time{more}</h2>"
    return f'{heading}<ul class="when">{"".join(items)}</ul>'


def _odd_parts(result: Mapping[str, Any], times: Times) -> str:
    odd, count = result["parts"], result["parts_in_all"]
    if not odd:
        return ""
    rows = [
        (
            f"{one['part']}",
            escape(one["sensor"]),
            f"{one['begin'] + 0.0:,.0f} to {one['end']:,.0f}",
            marked(result, f"parts.{k}.fixes"),
            marked(result, f"parts.{k}.rejected"),
            f"{100.0 * one['rejected'] / max(one['fixes'], 1):.3g} %",
            marked(result, f"parts.{k}.nis_per_dof"),
        )
        for k, one in enumerate(odd)
    ]
    head = ("part", "sensor", "from, to [s]", "fixes", "refused", "share", "NIS per dof of all")
    more = f", the {len(odd)} worst of {count:,}" if count > len(odd) else ""
    return f"<h2>Parts that stand out{more}</h2>" + _page.grid(head, rows)


def _each(every: int) -> str:
    return "each gyro sample" if every == 1 else f"{every} gyro samples"


def _run_table(
    found: Digest,
    result: Mapping[str, Any],
    folder: str,
    settings: Mapping[str, str] | None,
    command: str | None,
) -> str:
    done, options = result["replay"], found.note.get("options", {})
    kind = base.filter_words(result["filter"], smoothed=result["smoothed"])
    most = options.get("max_rejected")
    rows = {
        "Start (t = 0)": escape(found.note.get("epoch") or "not given"),
        "From, to": escape(when(float(found.edge[0]), float(found.edge[-1]))),
        "Length": spell_time(result["span_s"]),
        "Filter": escape(kind),
        **{name: escape(words) for name, words in (settings or {}).items()},
        "Starts again after": "never" if most is None else f"{most} measurements refused running",
        "Rows": f"{marked(result, 'counts.rows')} in {marked(result, 'counts.parts')} parts, one "
        f"for {_each(options.get('every', 1))}",
        "Parts": f"<code>{escape(folder)}</code>",
        "Gyro gaps": base.gap_words(found.gaps),
        "Rows that came too late": marked(result, "counts.late"),
    }
    if done is not None:
        how = "the last run after a stop, from its checkpoint" if done["resumed"] else "in one go"
        rows["Took"] = f"{marked(result, 'replay.elapsed_s')} s, {how}"
    else:
        rows["Ended"] = "not yet"
    if command:
        rows["Command"] = f"<code>{escape(command)}</code>"
    cells = (f"<tr><th>{escape(name)}</th><td>{text}</td></tr>" for name, text in rows.items())
    return f"<table>{''.join(cells)}</table>"
