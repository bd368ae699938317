"""Sections of a report that show an orbit and how well it is known."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore import _attitude_panels as attitude_panels
from celestcore._attitude_panels import growth
from celestcore._panels import XYZ, Panel, Section, Series
from celestcore.solution import Array

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarSolution

RADIUS = 6378137.0
"""Equatorial radius that heights are told from [m] (WGS 84)."""
ORBIT = (
    f"Height of the centre of mass above a sphere with the equatorial radius, {RADIUS / 1e3} km."
)
ERROR = (
    "Three sigma of the error expected along {axes}: 99.7 % of the true errors should be smaller. "
    "It falls with each fix and grows between fixes and in gaps."
)
BIAS = "Slow error of the GNSS positions as the filter estimates it, with its ±3 sigma, GCRS axes."
INERTIAL = "the GCRS' axes"
TRACK = "the orbit's own directions: radial, along the track, and across it"


def orbit(solution: GnssStarSolution) -> list[Section]:
    """Return the height, the errors expected, and the receiver's slow error if it is estimated."""
    t = solution.t
    height = (np.linalg.norm(solution.r, axis=1) - RADIUS) / 1e3
    position, velocity, names, axes = errors(solution)
    by = "smoother" if solution.smoothed else "filter"
    panels = tuple(
        growth(
            f"3 sigma of the {what}, as the {by} expects",
            unit,
            t,
            tuple(
                Series(name, 3.0 * sigma[:, k], XYZ[k][0], kind="line")
                for k, name in enumerate(names)
            ),
        )
        for what, unit, sigma in (("position", "m", position), ("velocity", "m/s", velocity))
    )
    out = [
        Section(
            "Orbit", ORBIT, (Panel("Height", "km", t, (Series("height", height),)),), name="orbit"
        ),
        Section("Expected orbit error", ERROR.format(axes=axes), panels, name="error"),
    ]
    if solution.gnss_bias is not None and solution.sigma_gnss_bias is not None:
        out.append(_receiver(t, solution.gnss_bias, solution.sigma_gnss_bias))
    return out


def _receiver(t: Array, value: Array, sigma: Array) -> Section:
    panels = tuple(
        Panel(
            f"Slow error of the receiver, {name}",
            "m",
            t,
            (Series(f"{name}, ±3 sigma", value[:, k], colour, half=3.0 * sigma[:, k]),),
            row="receiver",
        )
        for k, (colour, name) in enumerate(XYZ)
    )
    return Section("The receiver's slow error", BIAS, panels, name="receiver")


def errors(solution: GnssStarSolution) -> tuple[Array, Array, tuple[str, ...], str]:
    """Return 1-sigma of position [m] and velocity [m/s] (n, 3), the axes' names, and words.

    Radial, along and across the track if covariances were kept, else along the GCRS' axes.
    """
    p = solution.orbit_covariance
    if p is None:
        return solution.sigma_r, solution.sigma_v, ("x", "y", "z"), INERTIAL
    radial = _unit(solution.r)
    across = _unit(np.cross(solution.r, solution.v))
    turn = np.stack([radial, np.cross(across, radial), across], axis=1)
    parts = [
        np.sqrt(np.einsum("nij,njk,nik->ni", turn, p[:, k : k + 3, k : k + 3], turn))
        for k in (0, 3)
    ]
    return parts[0], parts[1], ("radial", "along", "across"), TRACK


def _unit(v: Array) -> Array:
    return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))


def attitude(solution: GnssStarSolution) -> list[Section]:
    """Return the attitude's sections, as far as there is one."""
    t, q, sigma = solution.t, solution.q, solution.sigma_q
    if q is None or sigma is None:
        return []
    out = [
        attitude_panels.attitude(t, q, sigma, "GCRS"),
        attitude_panels.error(t, sigma, "smoother" if solution.smoothed else "filter"),
    ]
    if solution.rate is not None:
        out.append(attitude_panels.rates(t, solution.rate))
    if solution.bias is not None and solution.sigma_bias is not None:
        out.append(attitude_panels.bias(t, solution.bias, solution.sigma_bias))
    return out
