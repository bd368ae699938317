"""Euler angles 3-2-1: yaw, pitch and roll of one frame in another."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import NORM_TOLERANCE, QUATERNION_HINT, BoolArray, FloatArray, array, number
from celestcore.errors import InputError
from celestcore.quaternion import QuaternionLike, continuous, from_matrix, from_rotation

MARGIN = float(np.radians(0.1))
"""How near to a pitch of 90 degrees the flag is set, unless told otherwise [rad]."""
_SINGULAR = 1e-10


class Euler321(NamedTuple):
    """Yaw, pitch and roll; each (...).

    Attributes
    ----------
    yaw : ndarray
        First turn, about z [rad], from -pi to pi.
    pitch : ndarray
        Second turn, about the new y [rad], from -pi/2 to pi/2.
    roll : ndarray
        Last turn, about the new x [rad], from -pi to pi.
    near_singular : ndarray of bool
        The pitch is so near to a right angle that yaw and roll mean little.

    Examples
    --------
    >>> Euler321(np.array(0.1), np.array(0.2), np.array(0.3), np.array(False)).pitch
    array(0.2)
    """

    yaw: FloatArray
    pitch: FloatArray
    roll: FloatArray
    near_singular: BoolArray


def euler_321(attitude: QuaternionLike, *, margin: float = MARGIN) -> Euler321:
    """Yaw, pitch and roll of an attitude, with a flag near a pitch of 90 degrees.

    The turns about z, y and x that take frame ``a`` to frame ``b``: with ``R_ab`` the matrix of
    ``q_ab``, ``R_ab = Rz(yaw) Ry(pitch) Rx(roll)`` in active rotations. With ``q_ob`` of a body in
    the orbital frame, yaw turns about nadir, pitch about the orbit's negative normal and roll
    about the direction of flight.

    Parameters
    ----------
    attitude : array_like (..., 4), array_like (..., 3, 3) or scipy Rotation
        ``q_ab`` or ``R_ab``, ``b`` to ``a``. Rows of NaN give NaN.
    margin : float
        Sets the flag where ``|pitch| > pi/2 - margin`` [rad].

    Returns
    -------
    Euler321
        `yaw`, `pitch`, `roll` [rad] and `near_singular`, each (...).

    Raises
    ------
    InputError
        If the shape is wrong, a quaternion is not of unit length or a matrix no rotation.

    Notes
    -----
    At a pitch of 90 degrees only ``yaw - roll`` is determined, at -90 degrees only ``yaw + roll``;
    `pitch` and these stay exact to rounding all the way. Yaw and roll themselves turn half a
    circle when an attitude passes overhead, and noise in them grows with ``1 / cos(pitch)``. Within
    1e-10 rad of the singularity roll is set to 0 and yaw takes the whole turn.

    Half sums and half differences of yaw and roll: Bernardes and Viollet, *Quaternion to Euler
    angles conversion*, PLoS ONE 17(11), 2022.

    Examples
    --------
    >>> angles = euler_321([np.cos(0.1), 0.0, 0.0, np.sin(0.1)])
    >>> float(angles.yaw.round(12)), bool(angles.near_singular)
    (0.2, False)
    >>> up = euler_321(from_euler_321(0.3, np.pi / 2, 0.1))
    >>> float(up.yaw.round(12)), float(up.roll), bool(up.near_singular)
    (0.2, 0.0, True)
    """
    width = number(margin, "margin", at_least=0.0)
    w, x, y, z = np.moveaxis(_quaternion(attitude), -1, 0)
    high, low = np.hypot(w + y, x - z), np.hypot(w - y, x + z)
    pitch = 2.0 * np.arctan2(high, low) - 0.5 * np.pi
    difference, total = np.arctan2(x - z, w + y), np.arctan2(x + z, w - y)  # half of roll -, + yaw
    total = np.where(low < _SINGULAR, -difference, total)
    difference = np.where(high < _SINGULAR, -total, difference)
    yaw, roll = _wrap(total - difference), _wrap(total + difference)
    near = np.abs(pitch) > 0.5 * np.pi - width
    return Euler321(yaw, np.asarray(pitch), roll, np.asarray(near))


def from_euler_321(yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike) -> FloatArray:
    """Quaternions of yaw, pitch and roll: the inverse of `euler_321`.

    Parameters
    ----------
    yaw, pitch, roll : array_like (...)
        Turns about z, the new y and the new x [rad]; they broadcast.

    Returns
    -------
    ndarray (..., 4)
        ``q_ab``, turned frame to first frame; sign-continuous along the last but one axis.

    Raises
    ------
    InputError
        If the shapes do not broadcast.

    Examples
    --------
    >>> from_euler_321(np.pi / 2, 0.0, 0.0).round(6)
    array([0.707107, 0.      , 0.      , 0.707107])
    """
    given = [0.5 * array(a, n) for a, n in ((yaw, "yaw"), (pitch, "pitch"), (roll, "roll"))]
    try:
        psi, theta, phi = np.broadcast_arrays(*given)
    except ValueError:
        listed = ", ".join(str(a.shape) for a in given)
        raise InputError(f"and pitch, roll: shapes {listed} do not fit", field="yaw") from None
    (c1, c2, c3), (s1, s2, s3) = (
        [f(angle) for angle in (psi, theta, phi)] for f in (np.cos, np.sin)
    )
    parts = (
        c3 * c2 * c1 + s3 * s2 * s1,
        s3 * c2 * c1 - c3 * s2 * s1,
        c3 * s2 * c1 + s3 * c2 * s1,
        c3 * c2 * s1 - s3 * s2 * c1,
    )
    q = np.stack(parts, axis=-1)
    return continuous(q) if q.ndim > 1 else q


def _wrap(angle: FloatArray) -> FloatArray:
    """Bring angles from -2 pi to 2 pi into -pi to pi."""
    turns = np.where(angle > np.pi, 1.0, 0.0) - np.where(angle < -np.pi, 1.0, 0.0)
    return np.asarray(angle - 2.0 * np.pi * turns)


def _quaternion(attitude: QuaternionLike) -> FloatArray:
    if callable(getattr(attitude, "as_quat", None)):
        return from_rotation(attitude)  # type: ignore[arg-type]
    a = array(attitude, "attitude")
    if a.ndim >= 2 and a.shape[-2:] == (3, 3):
        return _of_matrix(a)
    if a.ndim == 0 or a.shape[-1] != 4:
        raise InputError(
            f"has shape {a.shape}, needed is (..., 4) or (..., 3, 3)", field="attitude"
        )
    rows = a.reshape(-1, 4)
    norm = np.linalg.norm(rows, axis=1)
    bad = np.abs(norm - 1.0) > NORM_TOLERANCE  # not so of NaN
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            f"has norm {norm[row]:.6g} where a unit quaternion is needed; {QUATERNION_HINT}",
            field="attitude",
            row=row if a.ndim > 1 else None,
            value=rows[row],
        )
    return a


def _of_matrix(a: FloatArray) -> FloatArray:
    known = np.asarray(np.isfinite(a).all(axis=(-2, -1), keepdims=True))
    q = from_matrix(np.where(known, a, np.eye(3)))
    return np.where(known[..., 0], q, np.nan)
