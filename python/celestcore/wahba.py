"""Attitude from directions seen at one time: Wahba's problem by SVD, Davenport's q and QUEST.

Sources: Wahba, SIAM Review 7(3), 1965, problem 65-1; Shuster and Oh, *Three-axis attitude
determination from vector observations*, JGCD 4(1), 1981; Markley, J. Astronautical Sciences 36(3),
1988; Markley and Mortari, *Quaternion attitude estimation using vector observations*, J.
Astronautical Sciences 48(2-3), 2000. They write the attitude matrix ``A``, inertial to body; here
stands its transpose, the matrix of ``q_ib``.

Examples
--------
>>> body = [[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
>>> inertial = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
>>> solve(body, inertial).q.round(6)
array([ 0.707107,  0.      ,  0.      , -0.707107])
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import FloatArray, array
from celestcore.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["METHODS", "WahbaSolution", "solve"]

METHODS = ("svd", "davenport", "quest")
"""The names of the methods."""


@dataclass(frozen=True)
class WahbaSolution:
    """Attitudes of single frames.

    Attributes
    ----------
    q : ndarray (..., 4)
        Unit quaternions ``q_ib``, body to inertial. Along the last leading axis signs are
        continuous; the first has ``w >= 0``.
    covariance : ndarray (..., 3, 3) or None
        Covariance of the attitude error in the body frame [rad^2], ``q = q_hat * exp(dtheta / 2)``;
        None if no `sigma` was given.
    loss : ndarray (...)
        Wahba's loss at the optimum. With `sigma` and without `weights`, twice the loss is a
        chi-square variable with ``2 * vectors - 3`` degrees of freedom.
    vectors : ndarray (...) of int
        How many vectors were used.

    Examples
    --------
    >>> axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    >>> fix = solve(axes, axes, sigma=1e-3)
    >>> fix.sigma.round(6)
    array([0.001   , 0.001   , 0.000707])
    """

    q: FloatArray
    covariance: FloatArray | None
    loss: FloatArray
    vectors: NDArray[np.int64]

    @property
    def sigma(self) -> FloatArray:
        """1-sigma attitude error about the body axes [rad], (..., 3).

        Raises
        ------
        InputError
            If there is no covariance.

        Examples
        --------
        >>> pair = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
        >>> solve(pair, pair, sigma=[0.1, 0.2]).sigma.round(6)
        array([0.2     , 0.1     , 0.089443])
        """
        if self.covariance is None:
            raise InputError(
                "is needed for a covariance; weights alone do not tell the noise", field="sigma"
            )
        diagonal = np.diagonal(self.covariance, axis1=-2, axis2=-1)
        return np.asarray(np.sqrt(diagonal))

    def as_rotation(self) -> Rotation:
        """Return the attitudes as a `scipy.spatial.transform.Rotation`.

        Examples
        --------
        >>> solve([[1, 0, 0], [0, 1, 0]], [[1, 0, 0], [0, 1, 0]]).as_rotation().as_quat()
        array([0., 0., 0., 1.])
        """
        from celestcore.quaternion import as_rotation

        return as_rotation(self.q)


def solve(
    body: ArrayLike,
    inertial: ArrayLike,
    *,
    sigma: ArrayLike | None = None,
    weights: ArrayLike | None = None,
    method: str = "svd",
    degenerate: str = "raise",
) -> WahbaSolution:
    """Find the attitude that best turns body directions into inertial ones.

    It minimises ``sum(w * |r - R(q_ib) b|^2) / 2`` over all rotations, frame by frame. Leading axes
    broadcast; a frame may have any number of vectors.

    Parameters
    ----------
    body : array_like (..., k, 3)
        Measured directions in the body frame, of any length. Rows with a NaN or an infinity in
        `body` or `inertial` are missing: pad frames with fewer vectors with NaN.
    inertial : array_like (..., k, 3)
        The same directions in the inertial frame; ``(k, 3)`` where all frames see the same.
    sigma : float or array_like (..., k), optional
        1-sigma noise of each direction about any axis across it [rad]. It gives the covariance.
    weights : float or array_like (..., k), optional
        Weights, not negative; zero leaves a vector out. Without them ``1 / sigma**2``, without both
        one. With both, `weights` steer the attitude and `sigma` tells what that costs.
    method : {"svd", "davenport", "quest"}
        How the optimum is found, see Notes.
    degenerate : {"raise", "nan"}
        What becomes of frames that do not determine an attitude: an error, or rows of NaN.

    Returns
    -------
    WahbaSolution
        Attitudes ``q`` (..., 4), ``covariance`` (..., 3, 3) [rad^2, body frame], ``loss`` (...)
        and ``vectors`` (...).

    Raises
    ------
    InputError
        If a shape, a sigma or a weight is wrong, or a vector is zero. If the geometry of a frame is
        degenerate: no vector, one, all on one line (or so nearly that rounding decides), or
        vectors that contradict each other. Its ``row`` is the number of the frame in C order, its
        ``value`` the unit vector in the body frame about which any turn fits.

    Notes
    -----
    The covariance follows the QUEST measurement model, ``P = inv(sum((I - b b^T) / sigma^2))``
    (Shuster and Oh), with measured ``b``; it holds for errors that are small against a radian. With
    weights of another kind it is ``inv(H) G inv(H)`` with ``H = sum(w (I - b b^T))`` and
    ``G = sum(w^2 sigma^2 (I - b b^T))``. Weights alone tell no noise and give none.

    All methods find the same optimum. Let ``e`` be the smallest over the largest eigenvalue of the
    information matrix ``H``; rounding turns the answer about the weakest axis by some ``1e-16 / e``
    rad with ``"svd"`` (one-sided Jacobi), ten times as much with ``"davenport"`` (eigenvectors of
    his 4x4 matrix) and ``1e-17 / e^2`` with ``"quest"`` (Newton's method on the characteristic
    equation, sequential rotations near half a turn). QUEST is therefore the worse the narrower the
    field, or the more unequal the accuracies; where it ends further than 1e-8 rad from the optimum
    (``e`` below some 5e-5) Davenport's result is returned instead. Frames with ``e < 1e-12`` are
    degenerate, for instance two stars closer than 2e-6 rad.

    Examples
    --------
    >>> import numpy as np
    >>> from celestcore import quaternion as quat
    >>> stars = np.array([[1.0, 0.0, 0.0], [0.9, 0.4, 0.0], [0.9, 0.0, 0.4]])
    >>> q_ib = quat.exp([[0.0, 0.0, 0.3], [0.0, 0.0, 0.4]])
    >>> seen = quat.rotate(quat.conjugate(q_ib)[:, None], stars)
    >>> fix = solve(seen, stars, sigma=1e-5)
    >>> quat.log(fix.q).round(9) + 0.0
    array([[0. , 0. , 0.3],
           [0. , 0. , 0.4]])
    >>> fix.covariance.shape, fix.vectors
    ((2, 3, 3), array([3, 3]))
    >>> solve(stars[:1], stars[:1])
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: body, value (1.0, 0.0, 0.0): ...
    """
    _check_choice(method, "method", METHODS)
    _check_choice(degenerate, "degenerate", ("raise", "nan"))
    b, r = _vectors(body, "body"), _vectors(inertial, "inertial")
    given = {"sigma": sigma, "weights": weights}
    rows = {n: array(v, n) for n, v in given.items() if v is not None}
    shape = _shape(b.shape[:-1], r.shape[:-1], rows)
    b, r = _spread(b, (*shape, 3)), _spread(r, (*shape, 3))
    _check_directions(b, r)
    rows = {n: _spread(a, shape) for n, a in rows.items()}
    _check_rows(rows, np.all(np.isfinite(b) & np.isfinite(r), axis=-1, keepdims=True)[..., 0])
    frames = int(np.prod(shape[:-1]))
    out = _core.wahba_solve(b, r, rows.get("sigma"), rows.get("weights"), frames, method)
    if out["failed"] and degenerate == "raise":
        frame, vectors, axis = out["failed"][0]
        raise _degenerate(frame, vectors, axis, shape)
    return _solution(out, shape[:-1], covariance=sigma is not None)


def _solution(out: dict[str, Any], leading: tuple[int, ...], *, covariance: bool) -> WahbaSolution:
    q = np.asarray(out["q"]).reshape(*leading, 4)
    if leading and q.size:
        q = _continuous(q)
    p = np.asarray(out["covariance"]).reshape(*leading, 3, 3) if covariance else None
    loss, vectors = (np.asarray(out[name]).reshape(leading) for name in ("loss", "vectors"))
    return WahbaSolution(q, p, loss, vectors)


def _continuous(q: FloatArray) -> FloatArray:
    """Choose signs along the second-last axis; rows of NaN do not interrupt."""
    known = np.isfinite(q[..., 0])
    if known.all():
        from celestcore.quaternion import continuous

        return continuous(q)
    out = q.reshape(-1, *q.shape[-2:]).copy()
    for stack, good in zip(out, known.reshape(len(out), -1), strict=True):
        rows = stack[good]
        dots = np.einsum("ij,ij->i", rows[1:], rows[:-1])
        sign = np.cumprod(np.r_[np.ones(min(len(rows), 1)), np.where(dots < 0.0, -1.0, 1.0)])
        stack[good] = sign[:, None] * rows
    return out.reshape(q.shape)


def _check_choice(value: object, field: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        listed = ", ".join(repr(c) for c in choices)
        raise InputError(f"must be one of {listed}", field=field, value=value)


def _vectors(value: ArrayLike, field: str) -> FloatArray:
    v = array(value, field)
    if v.ndim < 2 or v.shape[-1] != 3:
        raise InputError(
            f"has shape {v.shape}, needed is (..., k, 3): one row for each vector", field=field
        )
    return v


def _shape(
    body: tuple[int, ...], inertial: tuple[int, ...], rows: dict[str, FloatArray]
) -> tuple[int, ...]:
    """Broadcast the leading axes and k; body and inertial must agree in k themselves."""
    k = body[-1]
    if inertial[-1] != k:
        raise InputError(
            f"holds {inertial[-1]} vectors a frame, body holds {k}; they go in pairs",
            field="inertial",
        )
    shape = _joined(body, inertial, "inertial", "(..., k, 3)")
    for field, a in rows.items():
        if a.ndim and a.shape[-1] not in (1, k):
            raise InputError(
                f"has {a.shape[-1]} columns for {k} vectors a frame; give one for each", field=field
            )
        shape = _joined(shape, a.shape, field, f"a number, ({k},) or (..., {k})")
    return shape


def _joined(
    shape: tuple[int, ...], other: tuple[int, ...], field: str, needed: str
) -> tuple[int, ...]:
    try:
        return np.broadcast_shapes(shape, other)
    except ValueError:
        raise InputError(
            f"leading axes {other[:-1]} do not broadcast to {shape[:-1]}; needed is {needed}",
            field=field,
        ) from None


def _spread(a: FloatArray, shape: tuple[int, ...]) -> FloatArray:
    return np.ascontiguousarray(np.broadcast_to(a, shape))


def _frame(index: int, shape: tuple[int, ...]) -> int | None:
    """Return the frame of a flat index over (..., k); None if there is only one."""
    return index // shape[-1] if len(shape) > 1 else None


def _check_directions(b: FloatArray, r: FloatArray) -> None:
    for field, v in (("body", b), ("inertial", r)):
        zero = ~v.any(axis=-1)
        if zero.any():
            index = int(np.argmax(zero))
            raise InputError(
                f"vector {index % zero.shape[-1]} is zero and has no direction; write NaN if it is "
                "missing",
                field=field,
                row=_frame(index, zero.shape),
            )


def _check_rows(rows: dict[str, FloatArray], used: NDArray[np.bool_]) -> None:
    needs = {"sigma": "finite and positive", "weights": "finite and not negative"}
    for field, a in rows.items():
        good = np.isfinite(a) & ((a > 0.0) if field == "sigma" else (a >= 0.0))
        bad = used & ~good
        if bad.any():
            index = int(np.argmax(bad))
            raise InputError(
                f"vector {index % bad.shape[-1]}: must be {needs[field]}; write NaN in the vector "
                "itself if it is missing",
                field=field,
                row=_frame(index, bad.shape),
                value=a.reshape(-1)[index],
            )


def _degenerate(
    frame: int, vectors: int, axis: list[float] | None, shape: tuple[int, ...]
) -> InputError:
    row = frame if len(shape) > 1 else None
    advice = "drop the frame, or pass degenerate='nan'"
    if axis is None:
        return InputError(
            "no vector is left in this frame, so no axis is observable; " + advice,
            field="body",
            row=row,
        )
    what = "vector leaves" if vectors == 1 else "vectors leave"
    return InputError(
        f"the turn about this body axis is unobservable: the frame's {vectors} {what} it free (on "
        f"one line, or contradicting each other); add a vector across it, {advice}",
        field="body",
        row=row,
        value=np.asarray(axis),
    )
