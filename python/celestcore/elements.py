"""Orbital elements: from position and velocity and back, anomalies, periods, two-body motion.

Angles are in radians, lengths in metres. Any conic will do; a length that only an ellipse has, such
as its period, is an error for the others. Two conventions take the place of what is not defined:

- circular (eccentricity below 1e-13): the argument of perigee is 0 and the true anomaly counts
  from the ascending node;
- equatorial (inclination within 1e-13 of 0 or pi): the node is the x axis, its right ascension 0.

Examples
--------
>>> orbit = Elements(a=7136.635e3, e=1.809e-3, i=1.134, raan=0.52, argp=0.52, nu=0.0)
>>> r, v = to_state(orbit)
>>> bool(np.isclose(from_state(r, v).a, orbit.a))
True
>>> float(period(orbit.a).round(1))
6000.0
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._anomaly import TWO_PI, broadcast, mean_to_true, refuse, true_to_mean
from celestcore._check import FloatArray, array, number
from celestcore.errors import InputError

__all__ = [
    "MU",
    "Elements",
    "from_state",
    "mean_motion",
    "mean_to_true",
    "period",
    "to_state",
    "true_to_mean",
    "two_body",
]

MU = 3.986004415e14
"""Gravitational parameter of the Earth [m^3/s^2], JGM-3."""
_TINY = 1e-13


class Elements(NamedTuple):
    """Keplerian elements; every field is a number or an array (...).

    Attributes
    ----------
    a : semi-major axis [m]; negative for a hyperbola, infinite for a parabola
    e : eccentricity
    i : inclination [rad], 0 to pi
    raan : right ascension of the ascending node [rad]
    argp : argument of perigee [rad]
    nu : true anomaly [rad]
    p : semi-latus rectum [m]; ``a (1 - e^2)`` if None, needed for a parabola

    Examples
    --------
    >>> Elements(7e6, 0.0, 0.9, 0.0, 0.0, 0.0).a
    7000000.0
    """

    a: Any
    e: Any
    i: Any
    raan: Any
    argp: Any
    nu: Any
    p: Any = None


def _vectors(value: ArrayLike, field: str) -> FloatArray:
    v = array(value, field)
    if v.ndim == 0 or v.shape[-1] != 3:
        raise InputError(f"needs a last axis of 3, got shape {v.shape}", field=field)
    refuse(~np.isfinite(v).all(axis=-1).reshape(-1), "must be finite", field, v[..., 0])
    return v


def _wrap(angle: FloatArray) -> FloatArray:
    """Return angles in [0, 2 pi); rounding may not push a small negative one to 2 pi."""
    turned = np.mod(angle, TWO_PI)
    return np.where(turned >= TWO_PI, 0.0, turned)


def from_state(r: ArrayLike, v: ArrayLike, *, mu: float = MU) -> Elements:
    """Osculating elements of positions and velocities.

    Vallado, *Fundamentals of Astrodynamics and Applications* (2013), algorithm 9, with angles by
    `arctan2` so that none loses digits near 0 or pi.

    Parameters
    ----------
    r, v : array_like (..., 3)
        Inertial positions [m] and velocities [m/s].
    mu : float
        Gravitational parameter [m^3/s^2].

    Returns
    -------
    Elements
        Each field is (...); node, perigee and anomaly in [0, 2 pi). `p` is filled in.

    Raises
    ------
    InputError
        If a row is not finite, or falls straight down so that it has no orbital plane.

    Examples
    --------
    >>> orbit = from_state([7e6, 0.0, 0.0], [0.0, 0.0, 7546.05329])
    >>> float(orbit.i.round(6)), bool(orbit.e < 1e-8)
    (1.570796, True)
    """
    position, velocity = np.broadcast_arrays(_vectors(r, "r"), _vectors(v, "v"))
    mu = number(mu, "mu", above=0.0)
    h = np.cross(position, velocity)
    radius, speed = np.linalg.norm(position, axis=-1), np.linalg.norm(velocity, axis=-1)
    _in_metres(mu, radius, "r")
    turning = np.linalg.norm(h, axis=-1)
    flat = ~(turning > 1e-12 * radius * speed).reshape(-1)
    refuse(flat, "no orbital plane: the velocity is zero or along the position", "v", speed)
    normal = h / turning[..., None]
    across = np.hypot(normal[..., 0], normal[..., 1])
    equatorial = across < _TINY
    node = np.stack([-normal[..., 1], normal[..., 0], np.zeros_like(across)], axis=-1)
    node = np.where(
        equatorial[..., None], [1.0, 0.0, 0.0], node / np.maximum(across, 1e-300)[..., None]
    )
    ahead = np.cross(normal, node)
    p = turning**2 / mu
    # e cos(nu) and e sin(nu)
    cosine = p / radius - 1.0
    sine = np.sqrt(p / mu) * (position * velocity).sum(axis=-1) / radius
    e = np.hypot(cosine, sine)
    circular = e < _TINY
    latitude = np.arctan2((position * ahead).sum(axis=-1), (position * node).sum(axis=-1))
    nu = np.where(circular, latitude, np.arctan2(sine, cosine))
    with np.errstate(divide="ignore"):
        a = 1.0 / (2.0 / radius - speed**2 / mu)
    return Elements(
        a=a,
        e=e,
        i=np.arctan2(across, normal[..., 2]),
        raan=np.where(equatorial, 0.0, _wrap(np.arctan2(node[..., 1], node[..., 0]))),
        argp=np.where(circular, 0.0, _wrap(latitude - nu)),
        nu=_wrap(nu),
        p=p,
    )


def _checked(elements: Elements) -> tuple[dict[str, FloatArray], FloatArray]:
    """Return the fields as arrays of one shape, and the semi-latus rectum."""
    fields = broadcast(**{k: v for k, v in elements._asdict().items() if v is not None})
    a, e = fields["a"], fields["e"]
    refuse((e < 0.0).reshape(-1), "must not be negative", "e", e)
    wrong = (e < 1.0) != (a > 0.0)
    wrong &= ~((e == 1.0) & np.isinf(a))
    if "p" in fields:
        p = fields["p"]
        wrong &= np.abs(e - 1.0) > 1e-9  # the sign of `a` is rounding there, `p` decides
    else:
        open_end = np.isinf(a).reshape(-1) | (e == 1.0).reshape(-1)
        refuse(open_end, "a parabola needs p, its semi-latus rectum", "a", a)
        p = a * (1.0 - e * e)
    refuse(wrong.reshape(-1), "must be positive for e < 1, negative for e > 1", "a", a)
    refuse(~(p > 0.0).reshape(-1), "must be positive", "p", p)
    return fields, p


def to_state(elements: Elements, *, mu: float = MU) -> tuple[FloatArray, FloatArray]:
    """Positions and velocities of orbital elements (Vallado 2013, algorithm 10).

    Parameters
    ----------
    elements : Elements
        Fields of any shapes that broadcast.
    mu : float
        Gravitational parameter [m^3/s^2].

    Returns
    -------
    r, v : ndarray (..., 3)
        [m] and [m/s], in the axes that the angles refer to.

    Raises
    ------
    InputError
        If eccentricity and semi-major axis contradict each other, a parabola has no `p`, or a true
        anomaly lies beyond a hyperbola's asymptote.

    Examples
    --------
    >>> r, v = to_state(Elements(7e6, 0.0, 0.0, 0.0, 0.0, [0.0, np.pi / 2]))
    >>> r.round(3) + 0.0
    array([[7000000.,       0.,       0.],
           [      0., 7000000.,       0.]])
    """
    mu = number(mu, "mu", above=0.0)
    f, p = _checked(elements)
    _in_metres(mu, p, "p" if elements.p is not None else "a")
    e, nu = f["e"], f["nu"]
    shape = 1.0 + e * np.cos(nu)
    refuse(~(shape > 1e-12).reshape(-1), "lies beyond the asymptote", "nu", nu)
    u = f["argp"] + nu
    cos_node, sin_node = np.cos(f["raan"]), np.sin(f["raan"])
    cos_i, sin_i = np.cos(f["i"]), np.sin(f["i"])
    node = np.stack([cos_node, sin_node, np.zeros_like(cos_node)], axis=-1)
    ahead = np.stack([-sin_node * cos_i, cos_node * cos_i, sin_i], axis=-1)

    def plane(x: FloatArray, y: FloatArray) -> FloatArray:
        return np.asarray(x[..., None] * node + y[..., None] * ahead)

    r = plane(*(p / shape * np.stack([np.cos(u), np.sin(u)])))
    along = np.sqrt(mu / p)
    ex, ey = e * np.cos(f["argp"]), e * np.sin(f["argp"])
    v = plane(-along * (np.sin(u) + ey), along * (np.cos(u) + ex))
    return r, v


def mean_motion(a: ArrayLike, *, mu: float = MU) -> FloatArray:
    """Mean motion [rad/s] of ellipses with semi-major axes `a` (...) [m].

    Parameters
    ----------
    a : array_like (...)
        Semi-major axes [m].
    mu : float
        Gravitational parameter [m^3/s^2].

    Raises
    ------
    InputError
        If one is not positive and finite: hyperbolas and parabolas have no period.

    Examples
    --------
    >>> float(mean_motion(7136.635e3).round(9))
    0.001047198
    """
    axis = array(a, "a")
    bad = ~((axis > 0.0) & np.isfinite(axis)).reshape(-1)
    refuse(bad, "only an ellipse comes round again: needs a positive semi-major axis", "a", axis)
    return np.asarray(np.sqrt(number(mu, "mu", above=0.0) / axis) / axis)


def period(a: ArrayLike, *, mu: float = MU) -> FloatArray:
    """Period [s] of ellipses with semi-major axes `a` (...) [m]; raises as `mean_motion` does.

    Parameters
    ----------
    a : array_like (...)
        Semi-major axes [m].
    mu : float
        Gravitational parameter [m^3/s^2].

    Examples
    --------
    >>> float(period(42164.2e3).round(0))
    86164.0
    """
    return np.asarray(TWO_PI / mean_motion(a, mu=mu))


def two_body(elements: Elements, t: ArrayLike, *, mu: float = MU) -> Elements:
    """Elements `t` seconds later if nothing but the point mass acts.

    Parameters
    ----------
    elements : Elements
        Now; its fields broadcast with `t`.
    t : array_like (...)
        Elapsed times [s], of either sign.
    mu : float
        Gravitational parameter [m^3/s^2].

    Returns
    -------
    Elements
        Only the true anomaly differs.

    Raises
    ------
    InputError
        As `to_state`.

    Examples
    --------
    >>> orbit = Elements(7e6, 0.1, 0.9, 0.0, 0.0, 1.0)
    >>> later = two_body(orbit, period(7e6))
    >>> float((later.nu - orbit.nu).round(9))
    6.283185307
    """
    mu = number(mu, "mu", above=0.0)
    f, p = _checked(elements)
    e, seconds = f["e"], array(t, "t")
    with np.errstate(divide="ignore"):
        conic = np.sqrt(mu / p**3) * np.abs(1.0 - e * e) ** 1.5
    rate = np.where(e == 1.0, 2.0 * np.sqrt(mu / p**3), conic)
    mean = true_to_mean(f["nu"], e) + rate * seconds
    return elements._replace(nu=mean_to_true(mean, e), p=elements.p)


def _in_metres(mu: float, length: FloatArray, field: str) -> None:
    """Refuse lengths that look like kilometres, under the Earth's gravity in metres."""
    if mu == MU:
        small = ~(length >= 1e5).reshape(-1)
        refuse(
            small, "looks like kilometres: lengths are in metres, multiply by 1000", field, length
        )
