"""Where an orbit filter starts: one orbit that most of the first few fixes agree on."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import checked, count
from celestcore._check import BoolArray, FloatArray, array, number, times
from celestcore.errors import CelestcoreError, InputError
from celestcore.gnss._consensus import MODEL, Consensus, Fixes
from celestcore.orbit import ForceModel

__all__ = ["OrbitStart", "orbit_start"]

KILOMETRES = 1e5
"""Half of the fixes nearer to the Earth's centre than this [m] are in kilometres."""


class OrbitStart(NamedTuple):
    """A state to start from, and which fixes it rests on.

    Attributes
    ----------
    t : float
        Time of the first fix [s], be it good or bad.
    r, v : ndarray (3,)
        Position [m] and velocity [m/s] then, GCRS.
    good : ndarray of bool (k,)
        Which of the fixes that were looked at agree with the orbit.

    Examples
    --------
    >>> start = OrbitStart(0.0, np.zeros(3), np.ones(3), np.array([True, True, False]))
    >>> t0, r0, v0, good = start
    >>> int(good.sum())
    2
    """

    t: float
    r: FloatArray
    v: FloatArray
    good: BoolArray


def orbit_start(
    t: ArrayLike,
    r_i: ArrayLike,
    v_i: ArrayLike | None = None,
    *,
    sigma: float = 1.0,
    sigma_velocity: float | None = None,
    fixes: int = 8,
    force: ForceModel | None = None,
    tables: dict[str, Any] | None = None,
    accel_sigma: float = MODEL,
) -> OrbitStart:
    """Find the orbit that the majority of the first fixes agrees on.

    A bad first fix does not matter, nor do several, as long as more than half are good.

    Parameters
    ----------
    t : array_like (n,)
        Times [s], increasing; gaps are welcome.
    r_i : array_like (n, 3)
        Positions [m], GCRS; convert Earth-fixed ones with `celestcore.frames.to_gcrs`.
    v_i : array_like (n, 3), optional
        Velocities [m/s], GCRS.
    sigma : float
        1-sigma of a position per axis [m].
    sigma_velocity : float, optional
        1-sigma of a velocity per axis [m/s]; by default a tenth of `sigma` per second.
    fixes : int
        How many are looked at, from the first one on.
    force : ForceModel, optional
        How the orbit goes on; J2 unless given.
    tables : dict, optional
        `celestcore.frames.environment`, for a force model that needs it.
    accel_sigma : float
        Acceleration that the force model may leave out [m/s^2]: over a time T fixes may be off by
        ``accel_sigma T^2 / 2`` more.

    Returns
    -------
    OrbitStart
        The least-squares orbit of the fixes that agree, at the time of the first one.

    Raises
    ------
    InputError
        If fewer than two fixes (one with velocity) are given, a value is not finite, positions are
        in kilometres, or no orbit agrees with the majority: says how many agree.

    Notes
    -----
    Candidate orbits come from every fix with its velocity, or from every pair of positions, by
    shooting with the state transition matrix. A fix agrees with a candidate if the chi-square of
    its residual, with the candidate's own uncertainty carried along, stays below what one good
    fix in ten thousand exceeds. The best candidates are refined by Gauss and Newton's iteration on
    the fixes that agree, and fixes are taken in and out by their deleted residuals. After Fischler
    and Bolles, Random Sample Consensus, Comm. ACM 24 (6), 1981, but with all samples.

    Examples
    --------
    >>> import celestcore as cc
    >>> t = np.arange(0.0, 80.0, 10.0)
    >>> orbit = cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> r = orbit.r + np.random.default_rng(1).standard_normal((8, 3))
    >>> r[0] += 500.0                                              # the first one is bad
    >>> start = orbit_start(t, r, sigma=1.0)
    >>> start.good.tolist()
    [False, True, True, True, True, True, True, True]
    >>> bool(np.linalg.norm(start.r - orbit.r[0]) < 10.0)
    True
    """
    most = count(fixes, "fixes")
    seconds = times(t, "t")
    z = _rows(r_i, "r_i", len(seconds))
    noise = np.full(3, number(sigma, "sigma", above=0.0))
    if v_i is not None:
        z = np.hstack([z, _rows(v_i, "v_i", len(seconds))])
        fallback = 0.1 * noise[0] if sigma_velocity is None else sigma_velocity
        noise = np.r_[noise, np.full(3, number(fallback, "sigma_velocity", above=0.0))]
    model = ForceModel.j2() if force is None else checked(force, "force", ForceModel)
    if model.needs_environment and tables is None:
        raise InputError(
            "are needed for this force model; celestcore.frames.environment makes them",
            field="tables",
        )
    slack = number(accel_sigma, "accel_sigma", at_least=0.0)
    seconds, z = seconds[:most], z[:most]
    _check_enough(z)
    search = Consensus(Fixes(seconds, z, noise, model, tables, slack))
    try:
        found = search.best()
    except CelestcoreError:
        found = None
    agreeing = 0 if found is None else int(found.good.sum())
    if found is None or not _enough(agreeing, *z.shape):
        raise InputError(_no_consensus(agreeing, len(z), noise), field="r_i")
    return OrbitStart(float(seconds[0]), found.first[:3].copy(), found.first[3:].copy(), found.good)


def _rows(value: ArrayLike, field: str, n: int) -> FloatArray:
    rows = array(value, field, (None, 3))
    if len(rows) != n:
        raise InputError(f"has {len(rows)} rows but t has {n}", field=field)
    bad = ~np.isfinite(rows).all(axis=1)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("must be finite", field=field, row=row, value=rows[row])
    return rows


def _check_enough(z: FloatArray) -> None:
    least = 1 if z.shape[1] == 6 else 2
    if len(z) < least:
        raise InputError(
            "needs two fixes at least, or one with velocity", field="r_i", value=len(z)
        )
    typical = float(np.median(np.linalg.norm(z[:, :3], axis=1)))
    if typical < KILOMETRES:
        raise InputError(
            f"is about {typical:.6g} m from the Earth's centre; positions are in metres, these "
            "look like kilometres: multiply by 1000",
            field="r_i",
            value=z[0, :3],
        )


def _enough(agreeing: int, n: int, width: int) -> bool:
    """Say whether it is a majority, and more than what makes an orbit if not all agree."""
    least = 1 if width == 6 else 2
    return agreeing == n or (2 * agreeing > n and agreeing > least)


def _no_consensus(agreeing: int, n: int, noise: FloatArray) -> str:
    given = f"sigma {noise[0]:.4g} m"
    if len(noise) == 6:
        given += f" and sigma_velocity {noise[3]:.4g} m/s"
    return (
        f"no orbit to start from: at most {agreeing} of {n} fixes agree with one, a majority is "
        f"needed. Let it look at more fixes, check {given}, or give a start yourself"
    )
