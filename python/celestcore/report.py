"""A replay as one HTML page that needs nothing beside it: words, tables and plots to zoom into."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import _attitude_panels as show
from celestcore import _page, _sensor_panels
from celestcore._curves import time_axis
from celestcore._files import replacing
from celestcore._fixes import Fixes, of_attitude
from celestcore._page import marked
from celestcore._panels import Panel, Section, Times
from celestcore.errors import InputError
from celestcore.solution import Array
from celestcore.summary import drift_words, headline, spell_time
from celestcore.units import ARCSEC, DEG_PER_HOUR

if TYPE_CHECKING:
    from celestcore.analysis import WithheldDrift
    from celestcore.solution import Solution

KINDS = (".html", ".png")
MOST_GAPS = 20
STYLE = """
body{font:16px/1.55 system-ui,-apple-system,"Segoe UI",Roboto,"DejaVu Sans",sans-serif;
color:#222;background:#fff;max-width:1080px;margin:0 auto;padding:2rem 1.2rem 4rem}
h1{font-size:1.9rem;line-height:1.2;margin:.2rem 0 .8rem}
h2{font-size:1.25rem;margin:2.4rem 0 .6rem;border-bottom:1px solid #ddd;padding-bottom:.25rem}
.kind{color:#666;margin:0}.lead{font-size:1.12rem;margin:.4rem 0 1.4rem}
.cards{display:grid;grid-template-columns:repeat(auto-fit,minmax(150px,1fr));gap:.8rem;
margin:1rem 0}
.card{background:#f5f7f9;border-radius:8px;padding:.7rem .9rem}
.card b{display:block;font-size:1.35rem;font-variant-numeric:tabular-nums}
.card span{color:#555;font-size:.86rem}
.scroll{overflow-x:auto}
table{border-collapse:collapse;margin:.5rem 0 1rem;font-variant-numeric:tabular-nums}
th,td{text-align:left;padding:.3rem 1.1rem .3rem 0;border-bottom:1px solid #eee;vertical-align:top}
th{font-weight:600;color:#444}table.grid td+td,table.grid th+th{text-align:right}
img{width:100%;height:auto;margin:.3rem 0}.note{color:#555;font-size:.95rem;margin:.2rem 0}
code{background:#f1f3f5;padding:.1rem .35rem;border-radius:4px;overflow-wrap:anywhere}
footer{margin-top:3rem;color:#666;font-size:.88rem}
"""


def write_report(
    path: str | os.PathLike[str],
    solution: Solution,
    result: Mapping[str, Any],
    *,
    drift: WithheldDrift | None = None,
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
) -> None:
    """Write the report: a page (.html) or the pictures alone (.png).

    Parameters
    ----------
    path : path
        Ends in .html or .png. The file appears whole or not at all.
    solution : Solution
    result : dict
        From `celestcore.summary.summary`.
    drift : WithheldDrift, optional
        The withheld-window test, to be drawn; `result` holds its summary.
    settings : dict of str to str, optional
        What the run was told (noise, gate, ...), shown as given.
    command : str, optional
        The command that made it.

    Raises
    ------
    InputError
        If the ending is another one, the directory does not exist, or the solution is empty.
    MissingDependencyError
        If pictures (.png) were asked for and matplotlib is not installed.
    """
    if kind(path) == ".png":
        from celestcore import plot

        plot.save(plot.figure(solution, plot.kept(solution)), path)
        return
    text = page(solution, result, drift=drift, settings=settings, command=command)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def kind(path: str | os.PathLike[str]) -> str:
    """Return the ending of a report's name, or raise `InputError` if it is not known."""
    ending = os.path.splitext(os.fspath(path))[1].lower()
    if ending not in KINDS:
        raise InputError(f"cannot write {os.fspath(path)}: a report ends in {' or '.join(KINDS)}")
    return ending


def page(
    solution: Solution,
    result: Mapping[str, Any],
    *,
    drift: WithheldDrift | None = None,
    settings: Mapping[str, str] | None = None,
    command: str | None = None,
) -> str:
    """Return the report as HTML text; parameters as in `write_report`."""
    if len(solution) == 0:
        raise InputError("the solution is empty: there is nothing to report", field="t")
    title = solution.title or "Attitude from gyros and star cameras"
    first, last = (float(solution.t[k]) for k in (0, -1))
    axis = time_axis(solution.t, solution.epoch)
    times = Times(axis, first, last, solution.epoch, solution.gaps)
    fixes = of_attitude(solution)
    panels: list[Panel] = []
    parts = [
        _cards(solution, result),
        _page.findings(result, times),
        "<h2>What was run</h2>",
        _run_table(solution, result, settings or {}, command),
        "<h2>What came out</h2>",
        sensor_table(result),
        final_table(result),
    ]
    if result.get("withheld"):
        parts += ["<h2>How far does it drift without fixes?</h2>", _withheld(result)]
        if drift is not None:
            parts.append(_page.places([show.drift(drift)], panels))
    parts += [
        "<h2>Over time</h2>",
        f'<p class="note">{escape(axis.label)}. {escape(_page.HELP)}</p>',
        *_page.sections(_sections(solution, fixes, times), panels),
        _page.noise_table(result),
        gap_table(solution.gaps),
        footer(solution.frames, result),
    ]
    lead = headline(dict(result))
    return _page.document(title, lead, parts, panels, times, result, STYLE)


def _sections(solution: Solution, fixes: list[Fixes], times: Times) -> list[Section]:
    """Return what is drawn."""
    t, sigma = solution.t, solution.sigma
    inertial = solution.frames.get("inertial", "the inertial frame")
    lanes = _page.lanes(fixes, times) if fixes else ""
    out = [
        show.attitude(t, solution.q, sigma[:, :3], inertial),
        show.error(t, sigma[:, :3], "smoother" if solution.smoothed else "filter"),
        show.rates(t, solution.rate),
        show.bias(t, solution.bias, sigma[:, 3:]),
        _sensor_panels.health(fixes, times.first, times.last, lanes),
        _sensor_panels.innovations(fixes),
        _sensor_panels.nis(fixes),
    ]
    lost = {"full": (), "nis": ("innovation",)}.get(
        solution.innovations, ("innovation", "nis", "health")
    )
    why = f"Not kept: innovations={solution.innovations!r}."
    return [Section(s.heading, why) if s.name in lost else s for s in out]


def _cards(solution: Solution, result: Mapping[str, Any]) -> str:
    sigma = np.asarray(solution.final.get("sigma", solution.sigma[-1]))[:3] / ARCSEC
    size, speed = float(np.sqrt(np.sum(sigma**2))), result["samples_per_second"]
    return _page.cards(
        [
            (marked(result, "counts.samples"), "gyro samples"),
            (marked(result, "counts.accepted"), "fixes used"),
            (marked(result, "counts.rejected"), "fixes rejected"),
            (
                marked(result, "innovation.rms_total_arcsec", "″"),
                "rms of prediction minus fix",
            ),
            (_page.number(size, "″"), "expected error at the end (1 sigma)"),
            (speed_words(speed), "gyro samples per second"),
        ]
    )


def _run_table(
    solution: Solution, result: Mapping[str, Any], settings: Mapping[str, str], command: str | None
) -> str:
    told = {name: escape(text) for name, text in settings.items()}
    rows = {
        "Log": escape(result["log"] or "unnamed"),
        "Start (t = 0)": escape(solution.epoch or "not given"),
        "Length": spell_time(result["span_s"]),
        "Filter": escape(filter_words(solution.filter, smoothed=solution.smoothed)),
        **told,
        "Fixes that set the start": marked(result, "counts.start"),
        "Missing measurements (NaN)": marked(result, "counts.missing"),
        "Fixes before the start or after the gyro's last sample": marked(result, "counts.outside"),
        "Gyro gaps": gap_words(solution.gaps),
    }
    if command:
        rows["Command"] = f"<code>{escape(command)}</code>"
    cells = (f"<tr><th>{escape(name)}</th><td>{text}</td></tr>" for name, text in rows.items())
    return f"<table>{''.join(cells)}</table>"


def gap_words(gaps: Array) -> str:
    """Return how many gaps (k, 2) there are, and the longest, in words."""
    if len(gaps) == 0:
        return "none"
    length = gaps[:, 1] - gaps[:, 0]
    longest = int(np.argmax(length))
    return (
        f"{len(length):,}, together {spell_time(float(length.sum()))}, the longest "
        f"{spell_time(float(length[longest]))} at t = {gaps[longest, 0]:.10g} s"
    )


def gap_table(gaps: Array) -> str:
    """Return the longest gaps (k, 2) as a table, longest first."""
    if len(gaps) < 2:
        return ""
    length = gaps[:, 1] - gaps[:, 0]
    order = np.argsort(-length, kind="stable")[:MOST_GAPS]
    rows = [(*(f"{v:.10g}" for v in gaps[k]), escape(spell_time(float(length[k])))) for k in order]
    more = "" if len(length) <= MOST_GAPS else f", the {MOST_GAPS} longest of {len(length):,}"
    return f"<h2>Gyro gaps{more}</h2>" + _page.grid(("begin [s]", "end [s]", "length"), rows)


def sensor_table(result: Mapping[str, Any]) -> str:
    """Return each sensor's counts, innovations and NIS."""
    rows = []
    for k, sensor in enumerate(result["sensors"]):
        at = f"sensors.{k}."
        rms = (marked(result, f"{at}rms_arcsec.{j}") for j in range(len(sensor["rms_arcsec"])))
        rows.append(
            (
                escape(sensor["name"]),
                marked(result, f"{at}fixes"),
                marked(result, f"{at}rejected"),
                " / ".join(rms),
                marked(result, f"{at}nis_per_dof"),
                marked(result, f"{at}inside_95", " %", 100.0),
            )
        )
    if not rows:
        lost = result["counts"]["accepted"] > 0
        return "<p>Innovations were not kept.</p>" if lost else "<p>No fixes.</p>"
    head = (
        "sensor",
        "fixes",
        "rejected",
        "innovation rms x / y / z [arcsec]",
        "NIS per dof (ideal 1)",
        "inside 95 % bounds",
    )
    return _page.grid(head, rows)


def final_table(result: Mapping[str, Any]) -> str:
    """Return the state at the end."""
    final = result["final"]
    if not final:
        return ""
    arcsec, rate = 1.0 / ARCSEC, 1.0 / DEG_PER_HOUR
    rows = [
        (
            f"body {axis}",
            marked(result, f"final.sigma.{k}", "", arcsec),
            marked(result, f"final.bias.{k}", "", rate),
            marked(result, f"final.sigma.{3 + k}", "", rate),
        )
        for k, axis in enumerate("xyz")
    ]
    head = (
        "at the end",
        "attitude 1 sigma [arcsec]",
        "gyro bias [deg/h]",
        "gyro bias 1 sigma [deg/h]",
    )
    q = ", ".join(f"{value:.9f}" for value in final["q"])
    return (
        _page.grid(head, rows)
        + f'<p class="note">Attitude at the end, t = {final["t"]:.10g} s, as a quaternion '
        f"(body to inertial, scalar first): <code>{q}</code></p>"
    )


def _withheld(result: Mapping[str, Any]) -> str:
    """Show the withheld-window test: how it was done, what came out, what it does not show."""
    withheld = result["withheld"]
    kinds = (("filter's prediction", "drift"), ("plain integration", "without_bias"))
    columns = ("5", "median", "95", "max", "rms")
    rows = [
        (name, *(marked(result, f"withheld.{key}_{c}_arcsec") for c in columns))
        for name, key in kinds
    ]
    head = ("drift [arcsec]", "5 %", "median", "95 %", "largest", "rms")
    words = (
        "In each window all fixes were hidden, so the attitude was carried on by the gyro alone; "
        "at its end the prediction was compared with the hidden fix. The filter predicts with the "
        "bias it had estimated; plain integration takes the reported rates as they are. The gyro "
        "noise behind the predicted sigma was estimated on other windows than the one it is "
        "compared with."
    )
    found = (
        f"{drift_words(dict(withheld))} The drift over its predicted sigma was "
        f"{withheld['ratio_median']:.2g} in the median and {withheld['ratio_max']:.2g} at most; "
        f"with a sigma that is exactly right the median would be 0.89, and a smaller one means "
        f"that the prediction is cautious."
    )
    limits = (
        "If the fixes are themselves the product of an onboard filter, they are a reference for "
        "the drift of the gyro, not an independent measure of the attitude."
    )
    return (
        f'<p class="note">{escape(words)}</p><p>{escape(found)}</p>{_page.grid(head, rows)}'
        f'<p class="note">{escape(limits)}</p>'
    )


def footer(frames: Mapping[str, str], result: Mapping[str, Any]) -> str:
    """Return the conventions and what made the page."""
    inertial = frames.get("inertial", "the inertial frame")
    body = f" ({frames['body']})" if "body" in frames else ""
    return (
        f"<footer>Conventions: quaternions are Hamilton, scalar first, and take vectors from the "
        f"body frame{escape(body)} to {escape(inertial)}; sigmas are about the body axes; "
        f"times count seconds from the start given above. 1 arcsec (″) = 1/3600 degree. "
        f"Made by celestcore {escape(str(result['version']))}; plots by uPlot "
        f"(MIT licence, © 2021 Leon Sorokin).</footer>"
    )


def speed_words(per_second: float | None) -> str:
    """Return a speed for people."""
    if per_second is None:
        return "n/a"
    big = per_second >= 1e5
    return f"{per_second / 1e6:.3g} million" if big else f"{per_second:,.0f}"


def filter_words(kind: str, *, smoothed: bool) -> str:
    """Return a filter's full name."""
    name = _FILTERS.get(kind.lower(), kind or "unknown")
    return f"{name}, forward and back: not causal" if smoothed else name


_FILTERS = {
    "ekf": "EKF (multiplicative extended Kalman filter)",
    "ukf": "UKF (unscented Kalman filter)",
    "srukf": "SRUKF (square-root unscented Kalman filter)",
    "iterated": "iterated EKF (re-linearises the last interval)",
    "invariant": "invariant EKF (error on the inertial side)",
    "literal": "UKF of Wang and Jiang on the 7-dimensional error quaternion",
}
