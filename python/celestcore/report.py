"""A replay as one HTML page that needs nothing beside it: words, tables and pictures."""

from __future__ import annotations

import base64
import io
import os
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import plot
from celestcore._files import replacing
from celestcore.errors import InputError
from celestcore.summary import drift_words, headline, per_sensor, spell_time
from celestcore.units import ARCSEC, DEG_PER_HOUR

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from celestcore.analysis import WithheldDrift
    from celestcore.solution import Solution

KINDS = (".html", ".png")
CAPTIONS = {
    "attitude": (
        "Attitude",
        "Where the spacecraft pointed, as 3-2-1 Euler angles that turn the axes of {inertial} "
        "into the body axes: yaw about z, then pitch about the new y, then roll about the new "
        "x. Yaw is the right ascension of the body x axis, pitch is minus its declination. A "
        "jump from 180 to -180 degrees is no motion; near ±90 degrees of pitch, yaw and roll "
        "are ill defined.",
    ),
    "bias": (
        "Gyro bias",
        "What the gyro reads when the body is at rest, as the filter estimates it, with the "
        "band in which it expects the true bias 99.7 % of the time (±3 sigma). The band "
        "should shrink and then hold; the line should stay inside the bands of later times. "
        "The first minutes may lie outside the picture.",
    ),
    "sigma": (
        "Expected attitude error",
        "One sigma of the error the filter expects about each body axis. It falls with each "
        "fix and grows between fixes and in gaps (grey).",
    ),
    "innovation": (
        "Innovations",
        "Each dot is a fix minus what the filter had predicted just before, about each body "
        "axis (for a direction sensor: across the direction). Dashed: ±3 sigma as predicted. "
        "99.7 % of the dots should lie between. A drift or a wave means that the noise is not "
        "white. Crosses are fixes the gate rejected; those beyond the scale are drawn at its "
        "edge.",
    ),
    "nis": (
        "Are the error bars right?",
        "The normalised innovation squared (NIS) is the square of the innovation measured in "
        "its own predicted sigmas. If the error bars are right it averages the number of "
        "degrees of freedom and 95 % of the dots lie in the green band (chi-square). Dots "
        "that sit high mean error bars too small; dots that sit low mean error bars too "
        "large. Fixes that were smoothed on board have errors that hang together from one to "
        "the next: then the dots sit low, and this test does not tell how good the error bars "
        "are over minutes.",
    ),
}
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
        If the ending is another one, or the directory does not exist.
    MissingDependencyError
        If matplotlib is not installed.
    """
    if kind(path) == ".png":
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
    title = solution.title or "Attitude from gyros and star cameras"
    inertial = solution.frames.get("inertial", "the inertial frame")
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width,initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        '<p class="kind">celestcore replay report</p>',
        f'<h1>{escape(title)}</h1><p class="lead">{escape(headline(dict(result)))}</p>',
        _cards(solution, result),
        "<h2>What was run</h2>",
        _run_table(solution, result, settings or {}, command),
        "<h2>What came out</h2>",
        _sensor_table(solution),
        _final_table(solution),
    ]
    if result.get("withheld"):
        parts += ["<h2>How far does it drift without fixes?</h2>", _withheld(result["withheld"])]
    if drift is not None:
        parts.append(_image(plot.drift_figure(drift, solution.epoch, width=9.5), "Drift"))
    for name, (heading, caption) in CAPTIONS.items():
        if name not in plot.kept(solution):
            why = f'<p class="note">Not kept: innovations={solution.innovations!r}.</p>'
            parts.append(f"<h2>{heading}</h2>{why}")
            continue
        words = escape(caption.format(inertial=inertial))
        picture = _image(plot.figure(solution, (name,), width=9.5), heading)
        parts.append(f'<h2>{heading}</h2><p class="note">{words}</p>{picture}')
    parts.append(_footer(solution, result, inertial))
    return "\n".join([*parts, "</body></html>", ""])


def _cards(solution: Solution, result: Mapping[str, Any]) -> str:
    counts, inn = result["counts"], result["innovation"]
    sigma = np.asarray(solution.final.get("sigma", solution.sigma[-1]))[:3] / ARCSEC
    speed = result["samples_per_second"]
    cards = [
        (f"{counts['samples']:,}", "gyro samples"),
        (f"{counts['accepted']:,}", "fixes used"),
        (f"{counts['rejected']:,}", "fixes rejected"),
        (_number(inn["rms_total_arcsec"], "″"), "rms of prediction minus fix"),
        (_number(float(np.sqrt(np.sum(sigma**2))), "″"), "expected error at the end (1 sigma)"),
        (_speed(speed), "gyro samples per second"),
    ]
    cells = "".join(f'<div class="card"><b>{v}</b><span>{w}</span></div>' for v, w in cards)
    return f'<div class="cards">{cells}</div>'


def _run_table(
    solution: Solution, result: Mapping[str, Any], settings: Mapping[str, str], command: str | None
) -> str:
    counts = result["counts"]
    rows = [
        ("Log", result["log"] or "unnamed"),
        ("Start (t = 0)", solution.epoch or "not given"),
        ("Length", spell_time(result["span_s"])),
        ("Filter", _filter(solution)),
        *settings.items(),
        ("Fixes that set the start", f"{counts['start']:,}"),
        ("Missing measurements (NaN)", f"{counts['missing']:,}"),
        ("Fixes before the start or after the gyro's last sample", f"{counts['outside']:,}"),
        ("Gyro gaps", _gaps(solution)),
    ]
    if command:
        rows.append(("Command", command))
    cells = (
        f"<tr><th>{escape(name)}</th><td>"
        + (f"<code>{escape(text)}</code>" if name == "Command" else escape(text))
        + "</td></tr>"
        for name, text in rows
    )
    return f"<table>{''.join(cells)}</table>"


def _gaps(solution: Solution) -> str:
    if len(solution.gaps) == 0:
        return "none"
    length = solution.gaps[:, 1] - solution.gaps[:, 0]
    longest = int(np.argmax(length))
    return (
        f"{len(length):,}, together {spell_time(float(length.sum()))}, the longest "
        f"{spell_time(float(length[longest]))} at t = {solution.gaps[longest, 0]:.10g} s"
    )


def _sensor_table(solution: Solution) -> str:
    rows = [
        (
            sensor["name"],
            f"{sensor['fixes']:,}",
            f"{sensor['rejected']:,}",
            " / ".join(_number(value) for value in sensor["rms_arcsec"]),
            _number(sensor["nis_per_dof"]),
            _number(None if sensor["inside_95"] is None else 100 * sensor["inside_95"], " %"),
        )
        for sensor in per_sensor(solution)
    ]
    if not rows:
        lost = solution.innovations == "none" and solution.counts.get("accepted", 0) > 0
        return "<p>Innovations were not kept.</p>" if lost else "<p>No fixes.</p>"
    head = (
        "sensor",
        "fixes",
        "rejected",
        "innovation rms x / y / z [arcsec]",
        "NIS per dof (ideal 1)",
        "inside 95 % bounds",
    )
    return _grid(head, rows)


def _final_table(solution: Solution) -> str:
    final = solution.final
    if not final:
        return ""
    sigma = np.asarray(final["sigma"])
    bias, bias_sigma = np.asarray(final["bias"]) / DEG_PER_HOUR, sigma[3:] / DEG_PER_HOUR
    rows = [
        (
            f"body {axis}",
            f"{sigma[k] / ARCSEC:#.3g}",
            f"{bias[k]:#.4g}",
            f"{bias_sigma[k]:#.2g}",
        )
        for k, axis in enumerate("xyz")
    ]
    head = (
        "at the end",
        "attitude 1 sigma [arcsec]",
        "gyro bias [deg/h]",
        "gyro bias 1 sigma [deg/h]",
    )
    q = ", ".join(f"{value:.9f}" for value in np.asarray(final["q"]))
    return (
        _grid(head, rows)
        + f'<p class="note">Attitude at the end, t = {float(final["t"]):.10g} s, as a quaternion '
        f"(body to inertial, scalar first): <code>{q}</code></p>"
    )


def _withheld(withheld: Mapping[str, Any]) -> str:
    """Show the withheld-window test: how it was done, what came out, what it does not show."""
    kinds = (("filter's prediction", "drift"), ("plain integration", "without_bias"))
    columns = ("5", "median", "95", "max", "rms")
    rows = [
        (name, *(_number(withheld[f"{key}_{column}_arcsec"]) for column in columns))
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
        f'<p class="note">{escape(words)}</p><p>{escape(found)}</p>{_grid(head, rows)}'
        f'<p class="note">{escape(limits)}</p>'
    )


def _image(figure: Figure, alt: str) -> str:
    """Return a figure as an image inside the page."""
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=140)
    data = base64.b64encode(buffer.getvalue()).decode("ascii")
    return f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'


def _footer(solution: Solution, result: Mapping[str, Any], inertial: str) -> str:
    body = f" ({solution.frames['body']})" if "body" in solution.frames else ""
    return (
        f"<footer>Conventions: quaternions are Hamilton, scalar first, and take vectors from the "
        f"body frame{escape(body)} to {escape(inertial)}; sigmas are about the body axes; "
        f"times count seconds from the start given above. 1 arcsec (″) = 1/3600 degree. "
        f"Made by celestcore {escape(str(result['version']))}.</footer>"
    )


def _grid(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    top = "".join(f"<th>{escape(name)}</th>" for name in head)
    lines = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>" for row in rows
    )
    return f'<div class="scroll"><table class="grid"><tr>{top}</tr>{lines}</table></div>'


def _number(value: float | None, unit: str = "") -> str:
    if value is None:
        return "n/a"
    return f"{value:,.0f}{unit}" if abs(value) >= 1000.0 else f"{value:.3g}{unit}"


def _speed(per_second: float | None) -> str:
    if per_second is None:
        return "n/a"
    big = per_second >= 1e5
    return f"{per_second / 1e6:.3g} million" if big else f"{per_second:,.0f}"


def _filter(solution: Solution) -> str:
    name = _FILTERS.get(solution.filter.lower(), solution.filter or "unknown")
    return f"{name}, forward and back: not causal" if solution.smoothed else name


_FILTERS = {
    "ekf": "EKF (multiplicative extended Kalman filter)",
    "ukf": "UKF (unscented Kalman filter)",
    "srukf": "SRUKF (square-root unscented Kalman filter)",
    "iterated": "iterated EKF (re-linearises the last interval)",
    "invariant": "invariant EKF (error on the inertial side)",
    "literal": "UKF of Wang and Jiang on the 7-dimensional error quaternion",
}
