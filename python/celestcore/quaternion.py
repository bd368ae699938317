"""Unit quaternions: Hamilton's product, scalar first ``(w, x, y, z)``.

All functions broadcast over the leading axes; the last axis is the quaternion or vector. Rotation
vectors are in radians and act on the right, ``q * exp(dtheta)``. A `scipy` ``Rotation`` is accepted
wherever a quaternion is. Formulas: Sola, *Quaternion kinematics for the error-state Kalman filter*,
2017 (arXiv:1711.02508), by equation number.

Examples
--------
>>> import numpy as np
>>> q = exp([0.0, 0.0, np.pi / 2])
>>> rotate(q, [1.0, 0.0, 0.0]).round(12)
array([0., 1., 0.])
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import array, directions
from celestcore.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

QuaternionLike: TypeAlias = "ArrayLike | Rotation"
FloatArray: TypeAlias = NDArray[np.float64]

__all__ = [
    "angle_between",
    "as_rotation",
    "conjugate",
    "continuous",
    "exp",
    "from_matrix",
    "from_rotation",
    "log",
    "multiply",
    "propagate",
    "right_jacobian",
    "right_jacobian_inverse",
    "rotate",
    "shortest_rotation",
    "slerp",
    "to_matrix",
]


def multiply(a: QuaternionLike, b: QuaternionLike) -> FloatArray:
    """Product of two quaternions (Sola eq. 12): first `b`, then `a`.

    Parameters
    ----------
    a, b : array_like (..., 4) or scipy Rotation
        ``q_ab`` and ``q_bc``.

    Returns
    -------
    ndarray (..., 4)
        ``q_ac``.

    Raises
    ------
    InputError
        If a last axis is not 4 or the leading axes do not broadcast.

    Examples
    --------
    >>> multiply([0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0])
    array([0., 0., 0., 1.])
    """
    (x, y), shape = _stacks(("a", a, 4), ("b", b, 4))
    return np.asarray(_core.quat_multiply(x, y)).reshape(*shape, 4)


def conjugate(q: QuaternionLike) -> FloatArray:
    """Conjugate, the inverse rotation of a unit quaternion.

    Parameters
    ----------
    q : array_like (..., 4) or scipy Rotation

    Returns
    -------
    ndarray (..., 4)

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> conjugate([1.0, 2.0, 3.0, 4.0])
    array([ 1., -2., -3., -4.])
    """
    (x,), shape = _stacks(("q", q, 4))
    return np.asarray(_core.quat_conjugate(x)).reshape(*shape, 4)


def rotate(q: QuaternionLike, v: ArrayLike) -> FloatArray:
    """Rotate vectors: ``v_a = q_ab * v_b * conj(q_ab)``.

    Parameters
    ----------
    q : array_like (..., 4) or scipy Rotation
        Unit quaternions ``q_ab``.
    v : array_like (..., 3)
        Vectors in frame ``b``.

    Returns
    -------
    ndarray (..., 3)
        The vectors in frame ``a``, same unit.

    Raises
    ------
    InputError
        If a last axis has not that length or the leading axes do not broadcast.

    Examples
    --------
    >>> rotate([0.0, 0.0, 0.0, 1.0], [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    array([[-1.,  0.,  0.],
           [ 0.,  0.,  1.]])
    """
    (x, y), shape = _stacks(("q", q, 4), ("v", v, 3))
    return np.asarray(_core.quat_rotate(x, y)).reshape(*shape, 3)


def exp(v: ArrayLike) -> FloatArray:
    """Quaternion of a rotation vector (Sola eq. 101).

    Parameters
    ----------
    v : array_like (..., 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray (..., 4)

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> exp([0.0, 0.0, 0.0])
    array([1., 0., 0., 0.])
    """
    (x,), shape = _stacks(("v", v, 3))
    return np.asarray(_core.quat_exp(x)).reshape(*shape, 4)


def log(q: QuaternionLike) -> FloatArray:
    """Rotation vector of a unit quaternion, the shortest one (Sola eq. 105).

    Parameters
    ----------
    q : array_like (..., 4) or scipy Rotation

    Returns
    -------
    ndarray (..., 3)
        rad, of length at most pi; ``q`` and ``-q`` give the same.

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> log([-1.0, 0.0, 0.0, 0.0])
    array([-0., -0., -0.])
    """
    (x,), shape = _stacks(("q", q, 4))
    return np.asarray(_core.quat_log(x)).reshape(*shape, 3)


def to_matrix(q: QuaternionLike) -> FloatArray:
    """Rotation matrix of a unit quaternion: ``v_a = R @ v_b`` (Sola eq. 115).

    Parameters
    ----------
    q : array_like (..., 4) or scipy Rotation

    Returns
    -------
    ndarray (..., 3, 3)

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> to_matrix([1.0, 0.0, 0.0, 0.0])
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    (x,), shape = _stacks(("q", q, 4))
    return np.asarray(_core.quat_to_matrix(x)).reshape(*shape, 3, 3)


def from_matrix(r: ArrayLike) -> FloatArray:
    """Quaternion of a rotation matrix, ``w >= 0``, by Shepperd's four branches.

    Parameters
    ----------
    r : array_like (..., 3, 3)
        Proper rotation matrices.

    Returns
    -------
    ndarray (..., 4)

    Raises
    ------
    InputError
        If a matrix is not orthogonal to 1e-6 or is a reflection.

    Examples
    --------
    >>> from_matrix([[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]])
    array([0., 0., 0., 1.])
    """
    m = _numbers(r, "r")
    if m.shape[-2:] != (3, 3):
        raise InputError(f"needs shape (..., 3, 3), got {m.shape}", field="r")
    with np.errstate(all="ignore"):
        off = np.abs(m @ np.swapaxes(m, -1, -2) - np.eye(3)).max(axis=(-2, -1), initial=0.0)
        bad = ~((off < 1e-6) & (np.linalg.det(m) > 0.0))
    if np.any(bad):
        row = int(np.argmax(bad.reshape(-1)))
        raise InputError(
            "is not a proper rotation matrix: its rows must be orthonormal, its determinant 1",
            field="r",
            row=row,
            value=m.reshape(-1, 3, 3)[row].tolist(),
        )
    flat = np.ascontiguousarray(m).reshape(-1, 9)
    return np.asarray(_core.quat_from_matrix(flat)).reshape(*m.shape[:-2], 4)


def angle_between(a: QuaternionLike, b: QuaternionLike) -> FloatArray:
    """Angle of the rotation between two attitudes.

    Parameters
    ----------
    a, b : array_like (..., 4) or scipy Rotation

    Returns
    -------
    ndarray (...)
        rad, 0 to pi; signs of quaternions do not matter.

    Raises
    ------
    InputError
        If a last axis has not that length or the leading axes do not broadcast.

    Examples
    --------
    >>> float(angle_between([1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]))
    0.0
    """
    (x, y), shape = _stacks(("a", a, 4), ("b", b, 4))
    return np.asarray(_core.quat_angle_between(x, y)).reshape(shape)


def slerp(a: QuaternionLike, b: QuaternionLike, s: ArrayLike) -> FloatArray:
    """Spherical linear interpolation along the shorter arc.

    Parameters
    ----------
    a, b : array_like (..., 4) or scipy Rotation
        Attitudes at ``s = 0`` and ``s = 1``.
    s : array_like (...)
        Fraction of the way; outside 0 to 1 it extrapolates.

    Returns
    -------
    ndarray (..., 4)

    Raises
    ------
    InputError
        If a last axis has not that length or the leading axes do not broadcast.

    Examples
    --------
    >>> log(slerp([1.0, 0.0, 0.0, 0.0], exp([0.0, 0.0, 1.0]), 0.25)).round(12)
    array([0.  , 0.  , 0.25])
    """
    part = _numbers(s, "s")[..., None]
    (x, y, z), shape = _stacks(("a", a, 4), ("b", b, 4), ("s", part, 1))
    return np.asarray(_core.quat_slerp(x, y, z)).reshape(*shape, 4)


def right_jacobian(v: ArrayLike) -> FloatArray:
    """Right Jacobian of the rotation group: ``exp(v + d) ~ exp(v) * exp(J @ d)`` (Sola eq. 183).

    Parameters
    ----------
    v : array_like (..., 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray (..., 3, 3)

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> bool(np.all(right_jacobian([0.0, 0.0, 0.0]) == np.eye(3)))
    True
    """
    (x,), shape = _stacks(("v", v, 3))
    return np.asarray(_core.quat_right_jacobian(x)).reshape(*shape, 3, 3)


def right_jacobian_inverse(v: ArrayLike) -> FloatArray:
    """Inverse of the right Jacobian (Sola eq. 184), for rotation vectors shorter than 2 pi.

    Parameters
    ----------
    v : array_like (..., 3)
        Rotation vectors, rad.

    Returns
    -------
    ndarray (..., 3, 3)

    Raises
    ------
    InputError
        If the last axis has not that length.

    Examples
    --------
    >>> v = [0.1, 0.2, 0.3]
    >>> (right_jacobian(v) @ right_jacobian_inverse(v)).round(12) + 0.0
    array([[1., 0., 0.],
           [0., 1., 0.],
           [0., 0., 1.]])
    """
    (x,), shape = _stacks(("v", v, 3))
    return np.asarray(_core.quat_right_jacobian_inverse(x)).reshape(*shape, 3, 3)


def shortest_rotation(a: ArrayLike, b: ArrayLike) -> FloatArray:
    """Rotation by the smallest angle that takes direction `a` to direction `b`.

    Parameters
    ----------
    a, b : array_like (..., 3)
        Vectors of any length but zero. Opposite ones are joined by half a turn about some
        perpendicular axis.

    Returns
    -------
    ndarray (..., 4)

    Raises
    ------
    InputError
        If a vector has no direction.

    Examples
    --------
    >>> shortest_rotation([1.0, 0.0, 0.0], [0.0, 5.0, 0.0]).round(6)
    array([0.707107, 0.      , 0.      , 0.707107])
    """
    (x, y), shape = _stacks(("a", a, 3), ("b", b, 3))
    x, y = directions(x, "a"), directions(y, "b")
    return np.asarray(_core.quat_shortest_rotation(x, y)).reshape(*shape, 4)


def continuous(q: QuaternionLike) -> FloatArray:
    """Choose signs along the second-last axis so that successive quaternions do not jump.

    Parameters
    ----------
    q : array_like (..., n, 4) or scipy Rotation

    Returns
    -------
    ndarray (..., n, 4)
        The first of each sequence keeps its sign.

    Raises
    ------
    InputError
        If the shape is wrong.

    Examples
    --------
    >>> continuous([[1.0, 0.0, 0.0, 0.0], [-1.0, 0.0, 0.0, 0.0]]) + 0.0
    array([[1., 0., 0., 0.],
           [1., 0., 0., 0.]])
    """
    x = _quaternions(q, "q")
    if x.ndim < 2 or x.shape[-1] != 4:
        raise InputError(f"needs shape (..., n, 4), got {x.shape}", field="q")
    flat = np.ascontiguousarray(x).reshape(-1, 4)
    return np.asarray(_core.quat_continuous(flat, x.shape[-2])).reshape(x.shape)


def propagate(
    q0: QuaternionLike, rates: ArrayLike, dt: ArrayLike, *, method: str = "exponential"
) -> FloatArray:
    """Attitude under a sequence of body rates, ``dq/dt = q * (0, omega) / 2`` (Sola eq. 199).

    Parameters
    ----------
    q0 : array_like (..., 4) or scipy Rotation
        First attitudes ``q_ib``.
    rates : array_like (..., n, 3)
        Body rates, rad/s, each held for its step.
    dt : float or array_like (n,)
        Steps, s.
    method : {"exponential", "rk4"}
        Closed form, exact for a constant rate, or the classical Runge-Kutta method.

    Returns
    -------
    ndarray (..., n + 1, 4)
        Row k is the attitude after k steps.

    Raises
    ------
    InputError
        If a last axis has not that length or the leading axes do not broadcast.

    Examples
    --------
    >>> q = propagate([1.0, 0.0, 0.0, 0.0], [[0.0, 0.0, 0.1]] * 10, 1.0)
    >>> log(q[-1]).round(12)
    array([0., 0., 1.])
    """
    w = _numbers(rates, "rates")
    step = np.atleast_1d(_numbers(dt, "dt"))
    if w.ndim < 2 or w.shape[-1] != 3:
        raise InputError(f"needs shape (..., n, 3), got {w.shape}", field="rates")
    n = w.shape[-2]
    if step.ndim != 1 or len(step) not in (1, n):
        raise InputError(f"needs one step or {n}, got shape {step.shape}", field="dt")
    start = _quaternions(q0, "q0")
    if start.ndim == 0 or start.shape[-1] != 4:
        raise InputError(f"needs a last axis of 4, got shape {start.shape}", field="q0")
    shape = _broadcast((start.shape[:-1], w.shape[:-2]))
    if 0 in shape:
        return np.empty((*shape, n + 1, 4))
    q = np.ascontiguousarray(np.broadcast_to(start, (*shape, 4)))
    w = np.ascontiguousarray(np.broadcast_to(w, (*shape, n, 3)))
    out = _core.quat_propagate(q, w, np.ascontiguousarray(step), method)
    return np.asarray(out).reshape(*shape, n + 1, 4)


def from_rotation(rotation: Rotation) -> FloatArray:
    """Return the quaternions of a `scipy.spatial.transform.Rotation`.

    Parameters
    ----------
    rotation : Rotation
        One, or a stack.

    Returns
    -------
    ndarray (..., 4)
        Scalar first.

    Examples
    --------
    >>> from scipy.spatial.transform import Rotation
    >>> from_rotation(Rotation.identity())
    array([1., 0., 0., 0.])
    """
    return _quaternions(rotation, "rotation")


def as_rotation(q: QuaternionLike) -> Rotation:
    """Return a `scipy.spatial.transform.Rotation` of quaternions.

    Parameters
    ----------
    q : array_like (..., 4)
        Scalar first.

    Returns
    -------
    Rotation

    Raises
    ------
    ValueError
        If the shape is wrong.
    MissingDependencyError
        If scipy is not installed.

    Examples
    --------
    >>> as_rotation([0.0, 0.0, 0.0, 1.0]).as_quat()
    array([0., 0., 1., 0.])
    """
    from celestcore._optional import require

    transform = require("scipy.spatial.transform", extra="scipy", what="as_rotation")
    rotation: Rotation = transform.Rotation.from_quat(np.roll(_quaternions(q, "q"), -1, axis=-1))
    return rotation


def _quaternions(q: Any, name: str) -> FloatArray:
    """Return quaternions, scalar first, of an array or of a scipy Rotation."""
    as_quat = getattr(q, "as_quat", None)
    if callable(as_quat):
        return np.roll(np.asarray(as_quat(), dtype=np.float64), 1, axis=-1)
    return _numbers(q, name)


def _numbers(value: Any, name: str) -> FloatArray:
    """Return a float64 array, without a copy where that is what it is."""
    if type(value) is np.ndarray and value.dtype == np.float64:
        return value
    return array(value, name)


def _broadcast(shapes: tuple[tuple[int, ...], ...]) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(*shapes)
    except ValueError:
        listed = " and ".join(str(s) for s in shapes)
        raise InputError(f"leading axes {listed} do not broadcast") from None


def _stacks(*given: tuple[str, Any, int]) -> tuple[list[FloatArray], tuple[int, ...]]:
    """Broadcast the leading axes and flatten them; last axes have the lengths asked for."""
    arrays = []
    for name, value, width in given:
        a = _quaternions(value, name) if width == 4 else _numbers(value, name)
        if a.ndim == 0 or a.shape[-1] != width:
            raise InputError(f"needs a last axis of {width}, got shape {a.shape}", field=name)
        arrays.append(a)
    shape = _broadcast(tuple(a.shape[:-1] for a in arrays))
    return [
        np.ascontiguousarray(np.broadcast_to(a, (*shape, a.shape[-1]))).reshape(-1, a.shape[-1])
        for a in arrays
    ], shape
