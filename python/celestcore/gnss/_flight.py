"""The true orbit of a scenario at the times of its sensors, computed once for all trials."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celestcore import frames
from celestcore._check import FloatArray
from celestcore.frames._rotation import EARTH_RATE
from celestcore.orbit import ForceModel, Trajectory, propagate


class Place(NamedTuple):
    """The orbit at some times (n,); all arrays are read-only."""

    t: FloatArray
    r_i: FloatArray
    v_i: FloatArray
    q_io: FloatArray
    rate_io: FloatArray
    """Rate of the orbital frame, in its own axes (n, 3) [rad/s]."""
    earth: FloatArray | None = None
    """GCRS to ITRS (n, 3, 3), where a GNSS receiver needs it."""
    r_e: FloatArray | None = None
    v_e: FloatArray | None = None


def flights(
    force: ForceModel,
    epoch: str,
    start: tuple[FloatArray, FloatArray],
    times: dict[str, FloatArray],
    fixed: tuple[str, ...],
) -> dict[str, Place]:
    """Return the orbit at several sets of times; those named in `fixed` also Earth-fixed."""
    every = np.unique(np.concatenate([[0.0], *times.values()]))
    zero = int(np.searchsorted(every, 0.0))
    limits = (float(every[0]), float(every[-1]))
    tables = frames.environment(epoch, limits) if force.needs_environment else None
    made = [
        propagate(force, epoch, *start, t, environment=tables)
        for t in (every[zero:], every[zero::-1])
    ]
    r = np.vstack([made[1].r[:0:-1], made[0].r])
    v = np.vstack([made[1].v[:0:-1], made[0].v])
    acceleration = force.acceleration(every, r, v, environment=tables)
    orbit = Trajectory(every, r, v)
    return {
        name: _place(orbit[rows], acceleration[rows], epoch if name in fixed else None)
        for name, rows in ((n, np.searchsorted(every, t)) for n, t in times.items())
    }


def _place(orbit: Trajectory, acceleration: FloatArray, epoch: str | None) -> Place:
    r, v = orbit.r, orbit.v
    place = Place(orbit.t, r, v, frames.orbital(r, v), orbital_rate(r, v, acceleration))
    if epoch is not None:
        earth = frames.gcrs_to_itrs(epoch, orbit.t)
        r_e, v_e = frames.to_itrs(epoch, orbit.t, r, v)
        place = place._replace(earth=earth, r_e=r_e, v_e=v_e)
    for value in place:
        if value is not None:
            value.flags.writeable = False
    return place


def orbital_rate(r: FloatArray, v: FloatArray, acceleration: FloatArray) -> FloatArray:
    """Return the rate of the orbital frame relative to the inertial one, in its own axes (n, 3).

    About the orbit's normal it is h / r^2; about the radius the plane turns by r a_n / h, a_n the
    acceleration along the normal (Gauss' equations of variation).
    """
    h = np.cross(r, v)
    size = np.linalg.norm(h, axis=1)
    radius = np.linalg.norm(r, axis=1)
    across = np.einsum("ij,ij->i", acceleration, h) / size
    return np.stack([np.zeros_like(size), -size / radius**2, -radius * across / size], axis=1)


def antenna(place: Place, offset: FloatArray, moving: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return Earth-fixed positions and velocities of a point off the centre of mass.

    `offset` [m] and `moving` [m/s] (n, 3) lead from the centre to it, inertial frame.
    """
    assert place.earth is not None
    assert place.r_e is not None
    assert place.v_e is not None
    away = np.einsum("nij,nj->ni", place.earth, offset)
    turning = EARTH_RATE * np.stack([-away[:, 1], away[:, 0], np.zeros(len(away))], axis=1)
    speed = np.einsum("nij,nj->ni", place.earth, moving) - turning
    return place.r_e + away, place.v_e + speed
