"""A replay with GNSS fixes as one HTML page, or as a picture."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

from celestcore import _gnss_plots as plots
from celestcore import _gnss_words as words
from celestcore._files import replacing
from celestcore.report import STYLE, _grid, _image, _number, kind
from celestcore.summary import spell_time

if TYPE_CHECKING:
    from celestcore._gnss_replay import GnssReplay

CAPTIONS = {
    "innovation": (
        "Innovations",
        "Each dot is a fix minus what the filter had predicted just before: along the axes of the "
        "GCRS, of star sensors about the body's axes. Dashed: ±3 sigma as predicted; 99.7 % of the "
        "dots should lie between. A drift or a wave means that the fixes' error is not white. "
        "Crosses are fixes that the gate refused.",
    ),
    "nis": (
        "Are the error bars right?",
        "The normalised innovation squared (NIS) is the square of the innovation measured in its "
        "own predicted sigmas. If the error bars are right it averages 3, and 95 % of the dots lie "
        "in the green band (chi-square).",
    ),
    "withheld": (
        "How far off is a prediction without fixes?",
        "From what the filter knew at the begin of a window, the orbit was predicted to its end "
        "with all fixes inside it hidden, and compared with the fix there; each mark is a window. "
        + words.REFERENCE,
    ),
    "pointing": (
        "Does the attitude agree with the orbit?",
        "Attitude of the star fixes about the orbital frame of the GNSS fixes, with its z axis to "
        "the geodetic nadir. Frames, Earth rotation, time tags and both sensors take part: for a "
        "spacecraft that steers to the nadir small angles say that the whole chain is right.",
    ),
    "sigma": (
        "Expected position error",
        "One sigma of the error that the filter expects. It falls with each fix and grows in gaps.",
    ),
}


def write_report(
    path: str | os.PathLike[str],
    replay: GnssReplay,
    result: Mapping[str, Any],
    *,
    command: str | None = None,
) -> None:
    """Write the report: a page (.html) or the pictures alone (.png).

    Parameters
    ----------
    path : path
        Ends in .html or .png. The file appears whole or not at all.
    replay : GnssReplay
    result : dict
        From `celestcore._gnss_replay.summary`.
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
        fig = plots.figure(replay)
        fig.suptitle(str(result["log"]), x=0.01, ha="left", fontsize=13, weight="bold")
        plots.save(fig, path)
        return
    text = page(replay, result, command=command)
    with replacing(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def page(replay: GnssReplay, result: Mapping[str, Any], *, command: str | None = None) -> str:
    """Return the report as HTML text; parameters as in `write_report`."""
    title = str(result["log"] or "Orbit and attitude from GNSS and star sensor")
    parts = [
        '<!doctype html><html lang="en"><head><meta charset="utf-8">',
        '<meta name="viewport" content="width=device-width,initial-scale=1">',
        f"<title>{escape(title)}</title><style>{STYLE}</style></head><body>",
        '<p class="kind">celestcore replay report</p>',
        f'<h1>{escape(title)}</h1><p class="lead">{escape(words.headline(dict(result)))}</p>',
        _cards(result),
        "<h2>What was run</h2>",
        _run_table(replay, result, command),
        "<h2>What came out</h2>",
        _innovation_table(result),
    ]
    names = plots.panels(replay)
    for group, (heading, caption) in CAPTIONS.items():
        own = tuple(name for name in names if name.split()[0] == group)
        if not own:
            continue
        parts.append(f'<h2>{heading}</h2><p class="note">{escape(caption)}</p>')
        parts.append(_TABLES.get(group, lambda _: "")(result))
        parts.append(_image(plots.figure(replay, own, width=9.5), heading))
    parts.append(
        "<footer>Conventions: positions and velocities along the axes of the GCRS; quaternions are "
        "Hamilton, scalar first, body to GCRS; times count seconds from the start given above. "
        f"Made by celestcore {escape(str(result['version']))}.</footer>"
    )
    return "\n".join([*parts, "</body></html>", ""])


def _cards(result: Mapping[str, Any]) -> str:
    kinds = result["innovations"]
    used = sum(kind["used"] for kind in kinds.values())
    refused = sum(kind["refused"] for kind in kinds.values())
    cards = [(f"{used:,}", "measurements used"), (f"{refused:,}", "refused")]
    if "position" in kinds:
        rms = _number(kinds["position"]["rms_total_m"], " m")
        cards.append((rms, "rms of position prediction minus fix"))
    for found in result["withheld"]:
        what = f"rms error predicted over {spell_time(found['window_s'])}"
        cards.append((_number(found["error_rms_m"], " m"), what))
    if result["pointing"] is not None:
        largest = _number(result["pointing"]["largest_deg"], "°")
        cards.append((largest, "largest angle to the geodetic nadir"))
    cells = "".join(f'<div class="card"><b>{v}</b><span>{w}</span></div>' for v, w in cards)
    return f'<div class="cards">{cells}</div>'


def _run_table(replay: GnssReplay, result: Mapping[str, Any], command: str | None) -> str:
    restarts = ", ".join(f"{t:.6g} s" for t in result["restarts"])
    rows = [
        ("Log", str(result["log"] or "unnamed")),
        ("Start (t = 0)", replay.solution.epoch),
        ("Length", spell_time(result["span_s"])),
        ("Filter", words.rows(dict(result))[0][1]),
        *words.settings_words(replay.navigator).items(),
        ("Missing measurements (NaN)", f"{result['counts']['missing']:,}"),
        ("Orbit filter started again at", restarts or "never"),
    ]
    cells = [f"<tr><th>{escape(n)}</th><td>{escape(text)}</td></tr>" for n, text in rows]
    if command:
        cells.append(f"<tr><th>Command</th><td><code>{escape(command)}</code></td></tr>")
    return f"<table>{''.join(cells)}</table>"


def _innovation_table(result: Mapping[str, Any]) -> str:
    rows = []
    for name, found in result["innovations"].items():
        key, unit = words.UNITS.get(name, ("arcsec", "arcsec"))
        inside = found["inside_95"]
        rows.append(
            (
                name,
                f"{found['used']:,}",
                f"{found['refused']:,}",
                " / ".join(_number(value) for value in found[f"rms_{key}"]) + f" {unit}",
                _number(found["nis_mean"]),
                _number(None if inside is None else 100.0 * inside, " %"),
            )
        )
    head = (
        "",
        "used",
        "refused",
        "innovation rms x / y / z",
        "NIS (ideal 3)",
        "inside 95 % bounds",
    )
    return _grid(head, rows)


def _withheld_table(result: Mapping[str, Any]) -> str:
    rows = [
        (
            spell_time(found["window_s"]),
            f"{found['windows']} ({found['apart']})",
            *(_number(found[f"error_{key}_m"]) for key in ("rms", "median", "95", "max")),
            _number(found["sigma_median_m"]),
            _number(100.0 * found["inside_95"], " %"),
        )
        for found in result["withheld"]
    ]
    head = ("window", "windows (without overlap)", "rms [m]", "median", "95 %", "largest")
    return _grid((*head, "predicted 1 sigma [m]", "inside 95 % ellipsoid"), rows)


def _pointing_table(result: Mapping[str, Any]) -> str:
    found = result["pointing"]
    rows = [
        (
            name,
            *(f"{found[f'{key}_deg'][k]:.2g}" for key in ("mean", "std", "max", "geocentric_std")),
        )
        for k, name in enumerate(("roll", "pitch", "yaw"))
    ]
    head = ("[deg]", "mean", "standard deviation", "largest", "geocentric: standard deviation")
    tags = words.tag_words(found)
    note = ""
    if tags is not None:
        note = (
            f"<p>Time tag of the attitude less that of the position: {escape(tags)} s. A late tag "
            "looks like a constant pitch; the body's own mean pitch is taken to be zero.</p>"
        )
    return _grid(head, rows) + note


_TABLES = {"withheld": _withheld_table, "pointing": _pointing_table}
