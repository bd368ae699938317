"""Integrate an orbit."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from celestcore import _core
from celestcore._check import FloatArray, array, number
from celestcore._epoch import epoch_string
from celestcore.errors import InputError
from celestcore.orbit.force import ForceModel

__all__ = ["Trajectory", "propagate"]

_EARTH_RADIUS = 6_378_137.0
_KILOMETRES = 1e5
"""Geocentric positions shorter than this [m] are taken for kilometres."""


@dataclass(frozen=True)
class Trajectory:
    """States of an orbit at given times; index it by row numbers, slices or masks.

    Attributes
    ----------
    t : ndarray
        (n,) s since the epoch.
    r, v : ndarray
        (n, 3) position [m] and velocity [m/s], GCRS.
    stm : ndarray or None
        (n, 6, 6) state transition matrices from ``t[0]``: derivatives of (r, v) at each time to
        (r, v) at the first.
    epoch : str or None
        Where the times count from.
    evaluations : int
        Evaluations of the acceleration that it took.

    Examples
    --------
    >>> t = np.arange(0.0, 600.0, 10.0)
    >>> orbit = propagate(ForceModel.j2(), None, [7e6, 0, 0], [0, 7.5e3, 0], t)
    >>> len(orbit), orbit[::2].r.shape, orbit[-1].t.tolist()
    (60, (30, 3), [590.0])
    """

    t: FloatArray
    r: FloatArray
    v: FloatArray
    stm: FloatArray | None = None
    epoch: str | None = None
    evaluations: int = 0

    def __len__(self) -> int:
        return len(self.t)

    def __getitem__(self, rows: Any) -> Trajectory:
        chosen = np.atleast_1d(np.arange(len(self.t))[rows])
        stm = None if self.stm is None else self.stm[chosen]
        return Trajectory(
            self.t[chosen], self.r[chosen], self.v[chosen], stm, self.epoch, self.evaluations
        )

    @property
    def state(self) -> FloatArray:
        """Position and velocity side by side (n, 6)."""
        return np.hstack([self.r, self.v])


def propagate(
    model: ForceModel,
    epoch: Any,
    r0: Any,
    v0: Any,
    t: Any,
    *,
    method: Literal["dop853", "rk4"] = "dop853",
    rtol: float = 1e-12,
    step: float | None = None,
    stm: bool = False,
    environment: dict[str, Any] | None = None,
) -> Trajectory:
    """Integrate an orbit through given times.

    Parameters
    ----------
    model : ForceModel
        What accelerates the satellite.
    epoch : str, astropy Time or None
        Where the times count from; an ISO string without a scale means UTC. None is enough where
        no force needs an environment, or where one is given.
    r0, v0 : (3,) array_like
        Position [m] and velocity [m/s] at ``t[0]``, GCRS.
    t : (n,) array_like
        Times of the output [s since the epoch], increasing or decreasing.
    method : "dop853" or "rk4"
        Dormand and Prince's method of order 8, with steps by its error estimate and dense output;
        or classical Runge-Kutta with equal steps between output times.
    rtol : float
        Error that a step of ``"dop853"`` may make, relative to |r| and |v|.
    step : float, optional
        Longest step [s]: for ``"rk4"`` 30 unless given, for ``"dop853"`` none.
    stm : bool
        Whether to integrate the state transition matrix as well (the steps do not depend on it
        beyond rounding).
    environment : dict, optional
        Tables from `celestcore.frames.environment`, to be used again; made from `epoch` unless
        given.

    Returns
    -------
    Trajectory
        States at all of `t`, the first being (r0, v0).

    Raises
    ------
    InputError
        For kilometres instead of metres (|r0| < 1e5 m), a start inside the Earth, times that do
        not go one way or leave the tables.
    NumericalError
        If the orbit enters the Earth.

    Notes
    -----
    Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 1993, section II.5.

    Examples
    --------
    >>> from celestcore import orbit
    >>> r0, v0 = [7e6, 0.0, 0.0], [0.0, 7546.0533, 0.0]
    >>> circle = orbit.propagate(orbit.ForceModel.two_body(), None, r0, v0, [0.0, 3000.0])
    >>> float(np.linalg.norm(circle.r[1]).round(-1))
    7000000.0
    """
    if not isinstance(model, ForceModel):
        raise InputError("must be a ForceModel", field="model", value=model)
    name = epoch_string(epoch)
    times = _times(t)
    start = [*position(r0), *velocity(v0)]
    if method == "rk4":
        longest = number(30.0 if step is None else step, "step", above=0.0)
    else:
        longest = np.inf if step is None else number(step, "step", above=0.0)
    tables = environment_of(model, name, times, environment)
    state, matrices, evaluations = _core.orbit_propagate(
        model._described(),
        tables,
        start,
        times,
        method,
        number(rtol, "rtol", above=0.0),
        longest,
        bool(stm),
    )
    r, v = np.ascontiguousarray(state[:, :3]), np.ascontiguousarray(state[:, 3:])
    return Trajectory(times, r, v, matrices, name, evaluations)


def _times(t: Any) -> FloatArray:
    times = array(t, "t", (None,))
    if times.size == 0:
        raise InputError("is empty; give at least the time of the start", field="t")
    bad = ~np.isfinite(times)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("a time must be finite", field="t", row=row, value=times[row])
    forwards = times[-1] >= times[0]
    wrong = np.diff(times) <= 0.0 if forwards else np.diff(times) >= 0.0
    if wrong.any():
        row = 1 + int(np.argmax(wrong))
        raise InputError(
            "times must go one way and not repeat", field="t", row=row, value=times[row]
        )
    return times


def vector(value: Any, field: str) -> FloatArray:
    out = array(value, field, (3,))
    if not np.isfinite(out).all():
        raise InputError("must be finite", field=field, value=out)
    return out


def position(r0: Any, field: str = "r0") -> FloatArray:
    r = vector(r0, field)
    radius = float(np.linalg.norm(r))
    if radius < _KILOMETRES:
        raise InputError(
            f"is {radius:.6g} m from the Earth's centre; positions are in metres, these look like "
            "kilometres: multiply by 1000",
            field=field,
            value=r,
        )
    if radius < 0.99 * _EARTH_RADIUS:
        raise InputError(
            f"lies inside the Earth, {radius:.6g} m from its centre", field=field, value=r
        )
    return r


def velocity(v0: Any, field: str = "v0") -> FloatArray:
    v = vector(v0, field)
    speed = float(np.linalg.norm(v))
    if 0.0 < speed < 20.0:
        raise InputError(
            f"is {speed:.6g} m/s; velocities are in m/s, these look like km/s: multiply by 1000",
            field=field,
            value=v,
        )
    return v


def environment_of(
    model: ForceModel, epoch: str | None, t: FloatArray, environment: dict[str, Any] | None
) -> dict[str, Any] | None:
    """Return the tables that the model needs, or none."""
    if not model.needs_environment:
        return None
    if environment is not None:
        return environment
    if epoch is None:
        raise InputError(
            "is needed for the Earth's rotation, the Sun and the Moon, such as "
            "'2026-01-01T00:00:00'",
            field="epoch",
        )
    frames = importlib.import_module("celestcore.frames")
    made: dict[str, Any] = frames.environment(epoch, (float(t.min()), float(t.max())))
    return made
