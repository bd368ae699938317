"""What a filter made of each sensor's measurements, in one shape for every navigator."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore.solution import Array
from celestcore.units import ARCSEC

if TYPE_CHECKING:
    from celestcore._health import Windows
    from celestcore.gnss import GnssStarNavigator, GnssStarSolution
    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator
    from celestcore.solution import Solution

GNSS_UNITS = {"position": ("m", 1.0), "velocity": ("m/s", 1.0)}


@dataclass(frozen=True, eq=False)
class Whole:
    """What is known of all of a sensor's measurements where `Fixes` hold only some of them.

    Attributes
    ----------
    rejected : int
    inside_3 : tuple of float
        Share of the used innovations within three predicted sigmas, by axis.
    inside_95 : float
        Share of the used NIS between the 95 % bounds.
    windows : Windows
        Health over time.
    """

    rejected: int
    inside_3: tuple[float, ...]
    inside_95: float
    windows: Windows


@dataclass(frozen=True, eq=False)
class Fixes:
    """The measurements of one sensor.

    Attributes
    ----------
    name, unit : str
    axes : tuple of str
        Names of the innovation's axes.
    t, nis : ndarray (m,)
    dof : int
    accepted : ndarray (m,) of bool
    innovation, sigma : ndarray (m, axes) or None
        In `unit`; None if they were not kept.
    configured : ndarray (axes,) or None
        The 1-sigma noise that the filter was told, in `unit`, along the same axes.
    noise_scale : float or None
        What its variance was multiplied by at the end of the run; None if the filter does not
        adapt.
    whole : Whole or None
        If the rows are only some of the measurements: what is known of all.
    """

    name: str
    unit: str
    axes: tuple[str, ...]
    t: Array
    nis: Array
    dof: int
    accepted: NDArray[np.bool_]
    innovation: Array | None
    sigma: Array | None
    configured: Array | None = None
    noise_scale: float | None = None
    whole: Whole | None = None

    @property
    def used(self) -> NDArray[np.bool_]:
        """Which measurements count: accepted, with a NIS."""
        return self.accepted & np.isfinite(self.nis)

    @property
    def assumed(self) -> Array | None:
        """The 1-sigma noise that predictions hold: as told, times what an adaptive filter found.

        What it had found at the end stands for all of the run: only while it was still finding
        out, about as many fixes as its `adaptive` says, did predictions hold another.
        """
        if self.configured is None or self.noise_scale is None:
            return self.configured
        held: Array = self.configured * np.sqrt(self.noise_scale)
        return held


def of_attitude(solution: Solution, configured: Mapping[str, Array] | None = None) -> list[Fixes]:
    """Return the fixes of an attitude solution, sensor by sensor, in arcsec.

    Parameters
    ----------
    solution : Solution
    configured : mapping of str to ndarray, optional
        From `configured_noise`.
    """
    out = []
    scales = solution.final.get("noise_scale", {})
    for index, name in enumerate(solution.sensor_names):
        rows = np.flatnonzero(solution.sensor == index)
        if len(rows) == 0:
            continue
        dof = int(solution.dof[rows][0])
        axes = ("body x", "body y", "body z") if dof == 3 else ("across 1", "across 2")
        full = solution.innovations == "full"
        told = None if configured is None else configured.get(name)
        out.append(
            Fixes(
                name=name,
                unit="arcsec",
                axes=axes,
                t=solution.measurement_t[rows],
                nis=solution.nis[rows],
                dof=dof,
                accepted=solution.accepted[rows],
                innovation=solution.innovation[rows, : len(axes)] / ARCSEC if full else None,
                sigma=solution.innovation_sigma[rows, : len(axes)] / ARCSEC if full else None,
                configured=None if told is None else told / ARCSEC,
                noise_scale=float(scales[name]) if name in scales else None,
            )
        )
    return out


def of_gnss(
    solution: GnssStarSolution, configured: Mapping[str, Array] | None = None
) -> list[Fixes]:
    """Return the fixes of a GNSS and star solution, kind by kind: m, m/s, or arcsec.

    Parameters
    ----------
    solution : GnssStarSolution
    configured : mapping of str to ndarray, optional
        From `configured_gnss_noise`.
    """
    out = []
    known = {} if configured is None else configured
    for innovations in (solution.gnss, solution.attitude):
        kinds = np.asarray(innovations.kind, dtype=str)
        for kind in dict.fromkeys(kinds.tolist()):
            rows = np.flatnonzero(kinds == kind)
            rows = rows[np.argsort(innovations.t[rows], kind="stable")]
            unit, scale = GNSS_UNITS.get(kind, ("arcsec", ARCSEC))
            frame = "inertial" if kind in GNSS_UNITS else "body"
            out.append(
                Fixes(
                    name=kind,
                    unit=unit,
                    axes=tuple(f"{frame} {axis}" for axis in "xyz"),
                    t=innovations.t[rows],
                    nis=innovations.nis[rows],
                    dof=3,
                    accepted=np.asarray(innovations.accepted[rows], dtype=bool),
                    innovation=innovations.innovation[rows] / scale,
                    sigma=innovations.sigma[rows] / scale,
                    configured=known[kind] / scale if kind in known else None,
                )
            )
    return out


def configured_noise(navigator: StarGyroNavigator, log: SensorLog) -> dict[str, Array]:
    """Return the 1-sigma noise each sensor is told to have, along the axes of its innovations.

    Of fixes that bring their own noise the root mean square.

    Parameters
    ----------
    navigator : StarGyroNavigator
    log : SensorLog

    Returns
    -------
    dict of str to ndarray (3,) or (2,)
        Body axes for star cameras, across the direction for others [rad].
    """
    out = _stars(navigator, log)
    for name, vector in log.vectors.items():
        sensor = navigator._direction(name)
        sigma: Any = vector.sigma
        if sigma is None:
            sigma = np.nan if sensor is None else sensor.sigma
        out[f"vector_{name}"] = np.full(2, np.sqrt(np.mean(np.square(sigma))))
    return out


def configured_gnss_noise(navigator: GnssStarNavigator, log: SensorLog) -> dict[str, Array]:
    """Return the same for a GNSS and star navigator: m, m/s along inertial axes, rad about body's.

    The Earth-fixed x and y axes turn, so along the inertial ones their mean square counts.
    """
    out = _stars(navigator, log)
    receiver = navigator.gnss
    for name, sigma in (("position", receiver.sigma), ("velocity", receiver.sigma_velocity)):
        if sigma is not None:
            x, y, z = np.broadcast_to(np.asarray(sigma, dtype=np.float64), 3).tolist()
            level = np.sqrt(0.5 * (x * x + y * y))
            out[name] = np.array([level, level, z])
    return out


def _stars(navigator: StarGyroNavigator | GnssStarNavigator, log: SensorLog) -> dict[str, Array]:
    out: dict[str, Array] = {}
    for name, table in log.stars.items():
        noise = navigator._camera(name)._noise(len(table), table.sigma, table.covariance)
        out[name] = np.sqrt(np.mean(noise[:, [0, 3, 5]], axis=0))
    return out
