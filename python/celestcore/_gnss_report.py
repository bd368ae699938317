"""A replay with GNSS fixes as one HTML page, or as a picture."""

from __future__ import annotations

import os
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore import _gnss_plots as plots
from celestcore import _gnss_words as words
from celestcore import _orbit_report, _page
from celestcore._files import replacing
from celestcore._page import marked
from celestcore._panels import INK, XYZ, Panel, Section, Series, X
from celestcore.report import kind
from celestcore.summary import spell_time
from celestcore.units import DEG

if TYPE_CHECKING:
    from celestcore._gnss_replay import GnssReplay
    from celestcore.analysis import NadirPointing, WithheldOrbit

CAPTIONS = {
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
    told = {"Filter": words.rows(dict(result))[0][1], **words.settings_words(replay.navigator)}
    told["Missing measurements (NaN)"] = f"{result['counts']['missing']:,}"
    return _orbit_report.page(
        replay.solution,
        result,
        settings=told,
        command=command,
        lead=words.headline(dict(result)),
        cards=_cards(result),
        more=_tests(replay, result),
    )


def _cards(result: Mapping[str, Any]) -> list[tuple[str, str]]:
    out = []
    if "position" in result["innovations"]:
        rms = marked(result, "innovations.position.rms_total_m", " m")
        out.append((rms, "rms of position prediction minus fix"))
    for k, found in enumerate(result["withheld"]):
        what = f"rms error predicted over {spell_time(found['window_s'])}"
        out.append((marked(result, f"withheld.{k}.error_rms_m", " m"), what))
    if result["pointing"] is not None:
        largest = marked(result, "pointing.largest_deg", "°")
        out.append((largest, "largest angle to the geodetic nadir"))
    return out


def _tests(replay: GnssReplay, result: Mapping[str, Any]) -> list[Section]:
    """Return predictions without fixes, and the attitude against the orbit."""
    out = []
    if replay.withheld:
        panels = tuple(_withheld(found) for found in replay.withheld)
        out.append(Section(*CAPTIONS["withheld"], panels, _withheld_table(result), "withheld"))
    if replay.pointing is not None:
        panels = (_pointing(replay.pointing),)
        out.append(Section(*CAPTIONS["pointing"], panels, _pointing_table(result), "pointing"))
    return out


def _withheld(found: WithheldOrbit) -> Panel:
    sigma = 3.0 * found.sigma
    top = float(np.max(np.concatenate([sigma, found.size]), initial=0.0))
    return Panel(
        f"Position error after {found.window:g} s without fixes",
        "m",
        found.start + 0.5 * found.window,
        (
            Series("3 sigma predicted", sigma, INK, kind="dash"),
            Series("prediction less fix", found.size, X, kind="dots"),
        ),
        zero=True,
        limits=(0.0, 1.2 * top or 1.0),
    )


def _pointing(found: NadirPointing) -> Panel:
    error = found.error / DEG
    return Panel(
        "Attitude (star fixes) about the geodetic nadir of the GNSS fixes",
        "deg",
        found.t,
        tuple(
            Series(name, error[:, k], XYZ[k][0]) for k, name in enumerate(("roll", "pitch", "yaw"))
        ),
    )


def _withheld_table(result: Mapping[str, Any]) -> str:
    rows = [
        (
            spell_time(found["window_s"]),
            f"{found['windows']} ({found['apart']})",
            *(
                marked(result, f"withheld.{k}.{key}_m")
                for key in ("error_rms", "error_median", "error_95", "error_max", "sigma_median")
            ),
            marked(result, f"withheld.{k}.inside_95", " %", 100.0),
        )
        for k, found in enumerate(result["withheld"])
    ]
    head = ("window", "windows (without overlap)", "rms [m]", "median", "95 %", "largest")
    return _page.grid((*head, "predicted 1 sigma [m]", "inside 95 % ellipsoid"), rows)


def _pointing_table(result: Mapping[str, Any]) -> str:
    found = result["pointing"]
    rows = [
        (
            name,
            *(
                marked(result, f"pointing.{key}_deg.{k}")
                for key in ("mean", "std", "max", "geocentric_std")
            ),
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
    return _page.grid(head, rows) + note
