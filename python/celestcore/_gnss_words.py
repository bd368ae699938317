"""A replay with GNSS fixes in words: a headline and rows of a table, from its summary."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from celestcore.gnss import GnssStarNavigator
from celestcore.orbit import ForceModel
from celestcore.sensors import StarCamera
from celestcore.summary import FEW_FIXES, MANY_REJECTED, spell_time, verdict
from celestcore.units import ARCSEC

AXES = {"position": "GCRS x y z", "velocity": "GCRS x y z"}
UNITS = {"position": ("m", "m"), "velocity": ("m_s", "m/s")}
REFERENCE = (
    "The fixes are the reference: errors that they keep for longer than a window are not seen."
)


def headline(result: dict[str, Any]) -> str:
    """Return a summary's outcome in plain words: what was done, and whether to believe it."""
    kinds = result["innovations"]
    seen = {name: kind["used"] + kind["refused"] for name, kind in kinds.items()}
    named = [_fixes(name, number) for name, number in seen.items()]
    refused = sum(kind["refused"] for kind in kinds.values())
    parts = [
        f"{spell_time(result['span_s']).capitalize()} with {_listed(named)}, "
        f"{f'{refused:,} of them refused' if refused else 'none refused'}."
    ]
    bad = [n for n, k in kinds.items() if k["refused"] > MANY_REJECTED * max(seen[n], 10)]
    if bad:
        parts.insert(
            0,
            f"Many of the fixes were refused ({', '.join(bad)}): their noise, the dynamics, a time "
            "offset or a frame is probably wrong.",
        )
    if result["restarts"]:
        parts.append(
            f"The orbit filter lost the fixes and started again {_times(len(result['restarts']))}."
        )
    position = kinds.get("position")
    if position is not None and position["rms_total_m"] is not None:
        parts.append(
            "Before each correction the predicted position was off the fix by "
            f"{position['rms_total_m']:.3g} m rms."
        )
        if not bad and position["used"] >= FEW_FIXES:
            parts.append(verdict(position))
    parts += [withheld_words(each) for each in result["withheld"]]
    if result["pointing"] is not None:
        parts.append(pointing_words(result["pointing"]))
    return " ".join(parts)


def withheld_words(found: dict[str, Any]) -> str:
    """Say how far a prediction without fixes was off, and what it had expected."""
    return (
        f"Predicted over {spell_time(found['window_s'])} without fixes it was off by "
        f"{found['error_rms_m']:.3g} m rms, {found['error_max_m']:.3g} m at most; "
        f"{100.0 * found['inside_95']:.3g} % of {found['windows']} windows lie inside their 95 % "
        f"ellipsoids, the predicted sigma being {found['sigma_median_m']:.3g} m."
    )


def pointing_words(found: dict[str, Any]) -> str:
    """Say how the body keeps to the geodetic nadir, and what that tells of the time tags."""
    if found["offset_s"] is None:
        return (
            f"The body is up to {found['largest_deg']:.2g} deg off the geodetic nadir of its GNSS "
            "fixes: it does not steer there."
        )
    std = " / ".join(f"{value:.2g}" for value in found["std_deg"])
    return (
        f"The attitude keeps to the geodetic nadir of its own GNSS fixes within "
        f"{found['largest_deg']:.2g} deg (standard deviation {std} deg in roll, pitch, yaw), to "
        f"the Earth's centre within {found['geocentric_largest_deg']:.2g} deg only."
    )


def tag_words(found: dict[str, Any]) -> str | None:
    """Say by how much attitude and position differ in time, by their tags and as found."""
    if found["offset_s"] is None:
        return None
    sigma = "" if found["offset_sigma_s"] is None else f" ± {found['offset_sigma_s']:.2g}"
    if found["found_difference_s"] is None:
        return f"attitude's tags ahead by {found['offset_s']:.2g}{sigma}"
    return f"{found['tag_difference_s']:.4f}; found {found['found_difference_s']:.4f}{sigma}"


def rows(result: dict[str, Any]) -> list[tuple[str, str]]:
    """Return the rows of the table that the terminal shows."""
    how = result["filter"] + (", smoothed" if result["smoothed"] else "")
    attitude = {"gyro": ", attitude by gyro", "kinematic": ", attitude without gyro"}
    out = [
        ("orbit filter", how + attitude.get(result["attitude"] or "", ", no attitude")),
        ("time covered", spell_time(result["span_s"])),
    ]
    for name, kind in result["innovations"].items():
        out += _innovation_rows(name, kind)
    out.append(("orbit restarts / fixes unused / missing", _counts(result)))
    for found in result["withheld"]:
        what = f"{spell_time(found['window_s'])} ahead"
        error = [found[f"error_{key}_m"] for key in ("rms", "median", "max")]
        out.append((f"{what}: error rms median max [m]", numbers(error)))
        cover = f"{found['sigma_median_m']:.3g}  {100.0 * found['inside_95']:.3g} %"
        out.append(("  its 1 sigma [m], inside 95 % ellipsoid", cover))
    if result["pointing"] is not None:
        out += _pointing_rows(result["pointing"])
    out += _final_rows(result["final"])
    for name, value in (result["slow_error"] or {}).items():
        out.append((f"slow error {name}, body x y z [arcsec]", numbers(value["value_arcsec"])))
    if result["rows_per_second"]:
        out.append(("speed [rows/s]", f"{result['rows_per_second']:,.0f}"))
    return out


def _innovation_rows(name: str, kind: dict[str, Any]) -> list[tuple[str, str]]:
    key, unit = UNITS.get(name, ("arcsec", "arcsec"))
    axes = AXES.get(name, "body x y z")
    inside = kind["inside_95"]
    inside = "n/a" if inside is None else f"{100.0 * inside:.3g} %"
    return [
        (f"{name}: used / refused", f"{kind['used']:,} / {kind['refused']:,}"),
        (f"  innovation rms, {axes} [{unit}]", numbers(kind[f"rms_{key}"])),
        ("  NIS (ideal 3), inside 95 % bounds", f"{numbers([kind['nis_mean']])}  {inside}"),
    ]


def _pointing_rows(found: dict[str, Any]) -> list[tuple[str, str]]:
    out = [
        (
            "off geodetic nadir, std roll pitch yaw [deg]",
            "  ".join(f"{value:.2g}" for value in found["std_deg"]),
        ),
        (
            "  largest; geocentric instead [deg]",
            f"{found['largest_deg']:.2g}; {found['geocentric_largest_deg']:.2g}",
        ),
    ]
    words = tag_words(found)
    if words is not None:
        out.append(("time tags, attitude less position [s]", words))
    return out


def _final_rows(final: dict[str, Any]) -> list[tuple[str, str]]:
    out = [
        ("final position 1 sigma, x y z [m]", numbers(final["sigma_r"])),
        ("final velocity 1 sigma, x y z [m/s]", numbers(final["sigma_v"])),
    ]
    if "sigma_q" in final:
        sigma = [value / ARCSEC for value in final["sigma_q"]]
        out.append(("final attitude 1 sigma, x y z [arcsec]", numbers(sigma)))
    return out


def settings_words(nav: GnssStarNavigator) -> dict[str, str]:
    """Return what a run was told of noise and forces, for tables."""
    gnss, dynamics = nav.gnss, nav.dynamics
    velocity = gnss.sigma_velocity
    out = {
        "Noise of positions": f"{_each(gnss.sigma)} m (1 sigma)",
        "Noise of velocities": "not used" if velocity is None else f"{_each(velocity)} m/s",
        "Noise of star fixes": _star(nav.star),
        "Forces": _forces(dynamics.force),
        "Unmodelled acceleration": f"{dynamics.accel_psd:.3g} m²/s³",
    }
    if gnss.bias is not None:
        out["Slow error of positions"] = f"{gnss.bias.sigma:.3g} m over {gnss.bias.tau:.4g} s"
    if np.any(gnss.lever_arm):
        out["Lever arm"] = f"{_each(gnss.lever_arm)} m"
    if gnss.time_offset or nav.star_time_offset:
        out["Time offsets"] = f"GNSS {gnss.time_offset:g} s, star {nav.star_time_offset:g} s"
    if nav.gyro is None:
        out["Jerk of the body"] = f"{nav.attitude.jerk_psd:.3g} rad²/s⁵"
    out["Gate"] = f"refuses fixes outside {100.0 * nav.gate:.6g} % of the chi-square law"
    return out


def _star(star: StarCamera | Mapping[str, StarCamera]) -> str:
    each = {"": star} if isinstance(star, StarCamera) else star
    parts = []
    for name, camera in each.items():
        sigma = camera.sigma
        noise = "as given" if sigma is None else f"{_each(np.asarray(sigma) / ARCSEC)} arcsec"
        parts.append(f"{name} {noise}".strip())
    return ", ".join(parts)


def _forces(force: ForceModel) -> str:
    gravity = force.gravity
    size = f"{gravity}×{gravity}" if isinstance(gravity, int) else str(gravity)
    if isinstance(gravity, tuple):
        size = f"{gravity[0]}×{gravity[1]}"
    more = [n for n in ("sun", "moon", "srp", "drag") if getattr(force, n)]
    return ", ".join([f"gravity {size}", *more])


def _each(values: Any) -> str:
    found = np.unique(np.atleast_1d(np.asarray(values, dtype=float)))
    if len(found) == 1:
        return f"{found[0]:.3g}"
    return " / ".join(f"{v:.3g}" for v in np.asarray(values, dtype=float))


def numbers(values: list[Any]) -> str:
    """Return numbers in a row, n/a for what is not known."""
    return "  ".join("n/a" if value is None else f"{value:.3g}" for value in values)


def _counts(result: dict[str, Any]) -> str:
    counts = result["counts"]
    return f"{len(result['restarts'])} / {counts['unused_at_start']} / {counts['missing']}"


def _fixes(name: str, number: int) -> str:
    words = {"position": "GNSS positions", "velocity": "velocities", "star": "star fixes"}
    return f"{number:,} {words.get(name, f'fixes of {name}')}"


def _listed(parts: list[str]) -> str:
    return " and ".join([", ".join(parts[:-1]), parts[-1]] if len(parts) > 1 else parts)


def _times(number: int) -> str:
    return {1: "once", 2: "twice"}.get(number, f"{number} times")
