"""Sections of a report that show an attitude, its rates and the gyro's bias."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore._curves import euler_321, settled
from celestcore._panels import INK, XYZ, Panel, Section, Series, X, Y
from celestcore.solution import Array
from celestcore.units import ARCSEC, DEG, DEG_PER_HOUR

if TYPE_CHECKING:
    from celestcore.analysis import WithheldDrift

ATTITUDE = (
    "Where the spacecraft pointed, as 3-2-1 Euler angles that turn the axes of {inertial} into the "
    "body axes: yaw about z, then pitch about the new y, then roll about the new x. Yaw is the "
    "right ascension of the body x axis, pitch is minus its declination. A jump from 180 to -180 "
    "degrees is no motion; near ±90 degrees of pitch, yaw and roll are ill defined. Hover (or put "
    "a finger on the plot) to read a value with its ±3 sigma; zoom in to see the band."
)
ERROR = (
    "Three sigma of the error expected about each body axis: 99.7 % of the true errors should be "
    "smaller. It falls with each fix and grows between fixes and in gaps (grey)."
)
RATE = "How fast the body turned about its axes in inertial space, the estimated bias taken out."
BIAS = (
    "What the gyro reads when the body is at rest, as the filter estimates it, with the band in "
    "which it expects the true bias 99.7 % of the time (±3 sigma). The band should shrink and then "
    "hold; the line should stay inside the bands of later times. The first minutes may lie outside "
    "the picture."
)
DRIFT = (
    "Each mark is a window in which all fixes were hidden: how far the prediction was off the fix "
    "at its end."
)


def attitude(t: Array, q: Array, sigma: Array, inertial: str) -> Section:
    """Return the Euler angles with their bands.

    Parameters
    ----------
    t : ndarray (n,)
    q : ndarray (n, 4)
        Body to inertial.
    sigma : ndarray (n, 3)
        About the body's axes [rad].
    inertial : str
        The frame's name.
    """
    angles = euler_321(q)
    half = 3.0 * euler_sigma(angles, sigma) / DEG
    turned = np.unwrap(angles, axis=0) / DEG
    series = tuple(
        Series(name, turned[:, k], XYZ[k][0], half=np.minimum(half[:, k], 180.0))
        for k, name in enumerate(("yaw", "pitch", "roll"))
    )
    panel = Panel("Euler angles", "deg", t, series, limits=(-185.0, 185.0), period=360.0)
    return Section("Attitude", ATTITUDE.format(inertial=inertial), (panel,), name="attitude")


def euler_sigma(angles: Array, sigma: Array) -> Array:
    """Return the 1-sigma of yaw, pitch, roll from those about the body's axes (n, 3) [rad].

    A small turn about the body's axes changes the angles as the body's rates do (kinematics of
    3-2-1 Euler angles). Correlations between the axes are left out.
    """
    pitch, roll = angles[:, 1], angles[:, 2]
    sr, cr = np.sin(roll) ** 2, np.cos(roll) ** 2
    x, y, z = (sigma**2).T
    across = np.maximum(np.cos(pitch) ** 2, 1e-12)
    yaw = (sr * y + cr * z) / across
    variance = [yaw, cr * y + sr * z, x + np.sin(pitch) ** 2 * yaw]
    return np.asarray(np.sqrt(np.stack(variance, axis=-1)))


def error(t: Array, sigma: Array, by: str) -> Section:
    """Return 3 sigma about the body's axes; `sigma` (n, 3) in rad."""
    series = tuple(
        Series(f"body {name}", 3.0 * sigma[:, k] / ARCSEC, colour)
        for k, (colour, name) in enumerate(XYZ)
    )
    panel = growth(f"3 sigma of the attitude, as the {by} expects", "arcsec", t, series)
    return Section("Expected attitude error", ERROR, (panel,), name="sigma")


def growth(title: str, unit: str, t: Array, series: tuple[Series, ...]) -> Panel:
    """Return a panel of sigmas: from zero, or with a logarithmic axis if they differ much."""
    values = np.concatenate([s.y for s in series])
    values = values[np.isfinite(values)]
    top = float(values.max()) if len(values) else 1.0
    wide = top > 30.0 * max(float(np.median(values)) if len(values) else 1.0, 1e-12)
    if wide:
        low = max(float(values[values > 0.0].min()), 1e-9 * top) if (values > 0.0).any() else 1e-9
        return Panel(title, unit, t, series, log=True, limits=(low / 1.3, 1.3 * top))
    return Panel(title, unit, t, series, zero=True, limits=(0.0, 1.25 * top or 1.0))


def rates(t: Array, rate: Array) -> Section:
    """Return the body's rates; `rate` (n, 3) in rad/s."""
    series = tuple(
        Series(f"body {name}", rate[:, k] / DEG, colour) for k, (colour, name) in enumerate(XYZ)
    )
    return Section("Body rates", RATE, (Panel("Rates", "deg/s", t, series),), name="rate")


def bias(
    t: Array,
    value: Array,
    sigma: Array,
    what: str = "Gyro bias",
    calm: tuple[Array, Array] | None = None,
) -> Section:
    """Return the gyro's bias with its bands; `value` and `sigma` (n, 3) in rad/s.

    `calm` is the same of rows that set the picture's limits, where `value` holds all extremes.
    """
    panels = []
    usual = (value, sigma) if calm is None else calm
    low, high = ((usual[0] + k * usual[1]) / DEG_PER_HOUR for k in (-3.0, 3.0))
    for k, (colour, name) in enumerate(XYZ):
        y, half = value[:, k] / DEG_PER_HOUR, 3.0 * sigma[:, k] / DEG_PER_HOUR
        panels.append(
            Panel(
                f"{what}, body {name}",
                "deg/h",
                t,
                (Series(f"bias {name}, ±3 sigma", y, colour, half=half),),
                limits=settled(low[:, k], high[:, k]),
                row=what,
            )
        )
    return Section(what, BIAS, tuple(panels), name="bias")


def drift(found: WithheldDrift) -> Panel:
    """Return how far predictions drifted in windows without fixes."""
    size, plain = found.drift / ARCSEC, found.drift_without_bias / ARCSEC
    sigma = 3.0 * found.sigma / ARCSEC
    every = np.concatenate([size, plain, sigma])
    every = every[every > 0.0]
    low, high = (float(every.min()), float(every.max())) if len(every) else (0.1, 1.0)
    return Panel(
        f"Drift after {found.window:g} s without fixes",
        "arcsec",
        found.start + 0.5 * found.window,
        (
            Series("3 sigma predicted", sigma, INK, kind="dash"),
            Series("plain integration of the rates", plain, Y, kind="rings"),
            Series("filter's prediction", size, X, kind="dots"),
        ),
        log=True,
        limits=(low / 1.5, 1.5 * high),
    )
