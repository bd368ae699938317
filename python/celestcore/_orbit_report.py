"""The report of an orbit, with or without an attitude: the same page, other panels."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import _findings, _orbit_panels, _page, _sensor_panels
from celestcore._curves import time_axis
from celestcore._files import replacing
from celestcore._fixes import configured_gnss_noise, of_gnss
from celestcore._page import marked
from celestcore._panels import Panel, Section, Times
from celestcore.errors import InputError
from celestcore.report import STYLE, kind
from celestcore.solution import package_version
from celestcore.summary import _plain, spell_time

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarNavigator, GnssStarSolution
    from celestcore.log import SensorLog

TITLE = "Orbit and attitude from GNSS and star sensors"


def orbit_summary(
    solution: GnssStarSolution,
    title: str | None = None,
    *,
    log: SensorLog | None = None,
    navigator: GnssStarNavigator | None = None,
) -> dict[str, Any]:
    """Return what came out of a GNSS and star run, JSON-ready; what its report's numbers are.

    Parameters
    ----------
    solution : GnssStarSolution
    title : str, optional
        What the log is called.
    log, navigator : SensorLog, GnssStarNavigator, optional
        What ran over what: tell the noise that each sensor was said to have.

    Returns
    -------
    dict
        ``log``, ``filter``, ``version``, ``smoothed``, ``span_s``, ``counts``, ``restarts`` [s],
        ``final`` (t, r, v, sigma_r, sigma_v, SI), ``sensors`` and ``findings`` as in
        `celestcore.summary.summary`.
    """
    t = solution.t
    names = ("t", "r", "v", "sigma_r", "sigma_v")
    out = {
        "log": title,
        "filter": solution.filter,
        "version": package_version(),
        "smoothed": solution.smoothed,
        "span_s": float(t[-1] - t[0]) if len(t) else 0.0,
        "counts": {key: int(value) for key, value in solution.counts.items()},
        "restarts": list(solution.restarts),
        "final": {name: getattr(solution, name)[-1] for name in names} if len(t) else {},
        **judged(solution, log, navigator),
    }
    plain: dict[str, Any] = _plain(out)
    return plain


def judged(
    solution: GnssStarSolution,
    log: SensorLog | None = None,
    navigator: GnssStarNavigator | None = None,
) -> dict[str, Any]:
    """Return ``sensors`` and ``findings`` of a summary."""
    t = solution.t
    first, last = (float(t[0]), float(t[-1])) if len(t) else (0.0, 0.0)
    told = None
    if log is not None and navigator is not None:
        told = configured_gnss_noise(navigator, log)
    sensors = [_findings.judge(fixes, first, last) for fixes in of_gnss(solution, told)]
    found = [*_findings.of_restarts(solution.restarts), *_findings.of_sensors(sensors)]
    if solution.bias is not None and solution.sigma_bias is not None:
        found += _findings.of_bias(t, solution.bias, solution.sigma_bias)
    used = any(sensor["accepted"] for sensor in sensors)
    return {"sensors": sensors, "findings": _findings.ranked(found, judged=used)}


def write_orbit_report(
    path: str | os.PathLike[str],
    solution: GnssStarSolution,
    result: Mapping[str, Any] | None = None,
    *,
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
) -> None:
    """Write the report of an orbit as one HTML page.

    Parameters
    ----------
    path : path
        Ends in .html. The file appears whole or not at all.
    solution : GnssStarSolution
    result : dict, optional
        From `orbit_summary`; entries may have been added.
    settings : dict of str to str, optional
        What the run was told, shown as given.
    command : str, optional
        The command that made it.

    Raises
    ------
    InputError
        If the ending is another one, the directory does not exist, or the solution is empty.
    """
    if kind(path) != ".html":
        raise InputError(f"cannot write {os.fspath(path)}: the report of an orbit ends in .html")
    told = orbit_summary(solution) if result is None else result
    text = page(solution, told, settings=settings, command=command)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(
    solution: GnssStarSolution,
    result: Mapping[str, Any],
    *,
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
    lead: str | None = None,
    cards: Sequence[tuple[str, str]] = (),
    more: Sequence[Section] = (),
) -> str:
    """Return the report as HTML text.

    Parameters
    ----------
    solution, result, settings, command
        As in `write_orbit_report`.
    lead : str, optional
        What came out, in words; by default a short `headline`.
    cards : sequence of (str, str)
        More large numbers (HTML), each with words.
    more : sequence of Section
        Tests of the solution, before what is drawn over time.
    """
    if len(solution) == 0:
        raise InputError("the solution is empty: there is nothing to report", field="t")
    first, last = (float(solution.t[k]) for k in (0, -1))
    axis = time_axis(solution.t, solution.epoch)
    times = Times(axis, first, last, solution.epoch)
    fixes = of_gnss(solution)
    panels: list[Panel] = []
    lanes = _page.lanes(fixes, times, carrier=None) if fixes else ""
    drawn = [
        *_orbit_panels.orbit(solution),
        *_orbit_panels.attitude(solution),
        _sensor_panels.health(fixes, first, last, lanes),
        _sensor_panels.innovations(fixes),
        _sensor_panels.nis(fixes),
    ]
    parts = [
        _cards(result, cards),
        _page.findings(result, times),
        "<h2>What was run</h2>",
        _run_table(solution, result, settings or {}, command),
        "<h2>What came out</h2>",
        _sensor_table(result),
        _final_table(result),
        *_page.sections(more, panels),
        "<h2>Over time</h2>",
        f'<p class="note">{escape(axis.label)}. {escape(_page.HELP)}</p>',
        *_page.sections(drawn, panels),
        _page.noise_table(result),
        "<footer>Conventions: positions and velocities along the axes of the GCRS; quaternions are "
        "Hamilton, scalar first, body to GCRS; times count seconds from the start given above. "
        f"Made by celestcore {escape(str(result['version']))}; plots by uPlot (MIT licence, "
        "© 2021 Leon Sorokin).</footer>",
    ]
    title = str(result["log"] or TITLE)
    return _page.document(title, lead or headline(result), parts, panels, times, result, STYLE)


def headline(result: Mapping[str, Any]) -> str:
    """Say what was done, and what stands out most."""
    fixes = sum(sensor["fixes"] for sensor in result["sensors"])
    rejected = sum(sensor["rejected"] for sensor in result["sensors"])
    words = f"{rejected:,} of them rejected" if rejected else "none rejected"
    first = result["findings"][0]["title"]
    return f"{spell_time(result['span_s'])} with {fixes:,} measurements, {words}. {first}."


def _cards(result: Mapping[str, Any], more: Sequence[tuple[str, str]]) -> str:
    items = list(more)
    for k, sensor in enumerate(result["sensors"]):
        items.append((marked(result, f"sensors.{k}.accepted"), f"{sensor['name']} used"))
        if sensor["rejected"]:
            items.append((marked(result, f"sensors.{k}.rejected"), f"{sensor['name']} rejected"))
    sigma = np.asarray(result["final"]["sigma_r"], dtype=float)
    size = _page.number(float(np.sqrt(np.sum(sigma**2))), " m")
    return _page.cards([*items, (size, "expected position error at the end (1 sigma)")])


def _run_table(
    solution: GnssStarSolution,
    result: Mapping[str, Any],
    settings: Mapping[str, str],
    command: str | None,
) -> str:
    restarts = ", ".join(f"{t:.10g} s" for t in result["restarts"])
    rows = {
        "Log": str(result["log"] or "unnamed"),
        "Start (t = 0)": solution.epoch,
        "Length": spell_time(result["span_s"]),
        "Filter": solution.filter + (", forward and back" if solution.smoothed else ""),
        **settings,
        "Orbit filter started again at": restarts or "never",
    }
    cells = [f"<tr><th>{escape(n)}</th><td>{escape(text)}</td></tr>" for n, text in rows.items()]
    if command:
        cells.append(f"<tr><th>Command</th><td><code>{escape(command)}</code></td></tr>")
    return f"<table>{''.join(cells)}</table>"


def _sensor_table(result: Mapping[str, Any]) -> str:
    rows = []
    for k, sensor in enumerate(result["sensors"]):
        at, noise = f"sensors.{k}.", sensor["noise"]
        rms = "n/a"
        if noise is not None:
            each = (marked(result, f"{at}noise.rms.{j}") for j in range(len(noise["rms"])))
            rms = " / ".join(each) + f" {escape(noise['unit'])}"
        rows.append(
            (
                escape(sensor["name"]),
                marked(result, f"{at}fixes"),
                marked(result, f"{at}rejected"),
                rms,
                marked(result, f"{at}nis_per_dof"),
                marked(result, f"{at}inside_95", " %", 100.0),
            )
        )
    head = (
        "measurement",
        "rows",
        "rejected",
        "innovation rms x / y / z",
        "NIS per dof (ideal 1)",
        "inside 95 % bounds",
    )
    return _page.grid(head, rows) if rows else "<p>No measurements.</p>"


def _final_table(result: Mapping[str, Any]) -> str:
    rows = [
        (
            f"GCRS {axis}",
            *(marked(result, f"final.{key}.{k}") for key in ("r", "sigma_r", "v", "sigma_v")),
        )
        for k, axis in enumerate("xyz")
    ]
    head = ("at the end", "position [m]", "1 sigma [m]", "velocity [m/s]", "1 sigma [m/s]")
    return _page.grid(head, rows)
