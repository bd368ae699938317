"""Attitude from GPS baselines: the direct method on two, least squares on any number.

Sources: Cohen, *Attitude determination using GPS*, dissertation, Stanford University, 1992; Lu,
*Development of a GPS multi-antenna system for attitude determination*, UCGE report 20073,
University of Calgary, 1995 (direct method and least squares); Markley, *Attitude determination
using vector observations and the singular value decomposition*, J. Astronautical Sciences 36(3),
1988.

Examples
--------
>>> antennas = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
>>> fix = gps_attitude(antennas, [[0.0, 2.0, 0.0], [-1.5, 0.0, 0.0]])
>>> fix.q.round(6), bool(fix.valid)
(array([0.707107, 0.      , 0.      , 0.707107]), True)
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import BoolArray, FloatArray, array, number
from celestcore.errors import InputError
from celestcore.frames._euler import MARGIN, Euler321
from celestcore.gnss._fit import Fit, Problem, fit, leave_one_out, length_excess
from celestcore.gnss.antennas import Antennas, observable
from celestcore.quaternion import from_matrix
from celestcore.wahba import _continuous

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

__all__ = ["GpsAttitude", "direct_attitude", "gps_attitude"]


@dataclass(frozen=True)
class GpsAttitude:
    """Attitudes from GPS baselines.

    Attributes
    ----------
    q : ndarray (..., 4)
        Unit quaternions ``q_fb``, body to the frame ``f`` of the measured baselines; NaN where not
        valid. Along the last leading axis signs are continuous; the first has ``w >= 0``.
    covariance : ndarray (..., 3, 3)
        Covariance of the attitude error in the body frame [rad^2], ``q = q_hat * exp(dtheta / 2)``;
        NaN where not valid.
    chi_square : ndarray (...)
        Weighted sum of the squared residuals of the last baselines tried; NaN where there was
        no attitude to try.
    dof : ndarray (...) of int
        Its degrees of freedom, ``3 k - 3`` with ``k`` baselines; 0 where there was no attitude.
    valid : ndarray (...) of bool
        The baselines used agree with the antennas and with each other.
    used : ndarray (..., n) of bool
        Which baselines made the attitude; none of a row that is not valid.

    Examples
    --------
    >>> fix = gps_attitude(Antennas(np.eye(3)), np.eye(3))
    >>> fix.dof.tolist(), fix.sigma.round(5)
    (6, array([0.00296, 0.00296, 0.00296]))
    """

    q: FloatArray
    covariance: FloatArray
    chi_square: FloatArray
    dof: NDArray[np.int64]
    valid: BoolArray
    used: BoolArray

    @property
    def sigma(self) -> FloatArray:
        """1-sigma attitude error about the body axes [rad], (..., 3).

        Examples
        --------
        >>> gps_attitude(Antennas(np.eye(3), sigma=0.01), np.eye(3)).sigma.round(4)
        array([0.0059, 0.0059, 0.0059])
        """
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=-2, axis2=-1)))

    def as_rotation(self) -> Rotation:
        """Return the attitudes as a `scipy.spatial.transform.Rotation`; all must be valid.

        Examples
        --------
        >>> gps_attitude(Antennas(np.eye(3)), np.eye(3)).as_rotation().as_quat().round(9) + 0.0
        array([0., 0., 0., 1.])
        """
        from celestcore.quaternion import as_rotation

        return as_rotation(self.q)


def direct_attitude(baselines: ArrayLike, second: ArrayLike, *, margin: float = MARGIN) -> Euler321:
    """Yaw, pitch and roll from two baselines by the direct method.

    Parameters
    ----------
    baselines : array_like (..., 2, 3)
        Measured vectors from the master antenna [m] in the frame the angles refer to, as a rule
        the orbital frame (x forward, y right, z nadir). The first is the body's x axis. Rows with
        NaN give NaN.
    second : array_like (3,)
        The second baseline in the body frame [m]; its y and z must not both be zero.
    margin : float
        As in `celestcore.frames.euler_321`.

    Returns
    -------
    Euler321
        `yaw`, `pitch`, `roll` [rad] and `near_singular`, each (...).

    Raises
    ------
    InputError
        If a shape is wrong, or the second baseline lies along x: roll is then unobservable.

    Notes
    -----
    ``yaw = atan2(y1, x1)``, ``pitch = -atan2(z1, hypot(x1, y1))``; with the second vector turned by
    both, ``l = R2(pitch) R3(yaw) l2``, ``roll = atan2(z_l y_b - y_l z_b, y_l y_b + z_l z_b)``. No
    length enters, nor what else the second baseline says of yaw and pitch: `gps_attitude` is at
    least as accurate and tells its covariance. With 1-sigma ``s`` per axis and length L pitch has
    ``s / L``, yaw ``s / (L cos(pitch))``.

    The method is also published for x forward, y right and z up, which is a left-handed frame:
    there the signs of z, and with them of pitch and roll, are the other ones. Change the sign of z
    before comparing.

    Examples
    --------
    >>> angles = direct_attitude([[2.0, 0.0, 0.0], [0.0, 1.5, 0.1]], [0.0, 1.5, 0.0])
    >>> float(np.degrees(angles.roll).round(2))
    3.81
    """
    b = array(baselines, "baselines")
    if b.ndim < 2 or b.shape[-2:] != (2, 3):
        raise InputError(f"has shape {b.shape}, needed is (..., 2, 3)", field="baselines")
    _, yb, zb = array(second, "second", (3,)).tolist()
    if not (np.isfinite([yb, zb]).all() and np.hypot(yb, zb) > 0.0):
        raise InputError(
            "lies along the first baseline: the turn about the body axis x (roll) is unobservable",
            field="second",
            value=second,
        )
    width = number(margin, "margin", at_least=0.0)
    (x1, y1, z1), (x2, y2, z2) = np.moveaxis(b, (-2, -1), (0, 1))
    flat = np.hypot(x1, y1)
    yaw, pitch = np.arctan2(y1, x1), -np.arctan2(z1, flat)
    ahead = np.cos(yaw) * x2 + np.sin(yaw) * y2
    y, z = np.cos(yaw) * y2 - np.sin(yaw) * x2, np.sin(pitch) * ahead + np.cos(pitch) * z2
    roll = np.arctan2(z * yb - y * zb, y * yb + z * zb)
    near = np.abs(pitch) > 0.5 * np.pi - width
    return Euler321(np.asarray(yaw), np.asarray(pitch), np.asarray(roll), np.asarray(near))


def gps_attitude(
    antennas: Antennas,
    measured: ArrayLike,
    *,
    covariance: ArrayLike | None = None,
    gate: float | None = 0.999,
) -> GpsAttitude:
    """Attitude from any number of GPS baselines, with their full covariance and a test for faults.

    Parameters
    ----------
    antennas : Antennas
        The layout, n baselines in the body frame, and their noise.
    measured : array_like (..., n, 3)
        The same baselines as GPS gives them [m], in any frame ``f``; rows with NaN are missing.
    covariance : array_like (3 n, 3 n) or (..., 3 n, 3 n), optional
        Their covariance in frame ``f`` [m^2], in the order x, y, z of the first, of the second ...
        Without it that of `antennas`, alike about all axes.
    gate : float or None
        Probability with which good baselines pass; None tests nothing.

    Returns
    -------
    GpsAttitude
        `q`, `covariance`, `chi_square`, `dof`, `valid` and `used`.

    Raises
    ------
    InputError
        If a shape is wrong, a covariance not symmetric and positive definite, or the gate no
        probability.
    NumericalError
        If the iteration with a full covariance does not settle.

    Notes
    -----
    It minimises ``sum(W_ij (f_i - A b_i) . (f_j - A b_j))`` over rotations ``A``, ``W`` the inverse
    of the covariance per axis: Wahba's problem with ``B = sum(W_ij f_i b_j^T)``, solved by SVD. A
    full covariance is taken on from there by Gauss-Newton. The covariance of the attitude is
    ``inv(sum(W_ij [b_i]x^T [b_j]x))``, exact while the noise is small against the baselines.

    Two tests share the risk ``1 - gate`` of turning good baselines down: each baseline's length
    against the antennas (a wrong ambiguity changes it), and the chi-square of the residuals. Where
    one fails and three or more baselines are there, the one without which the rest fits best is
    left out, and so on while two remain that are not on one line. If none can be spared the row is
    not valid. Two baselines can show that one is wrong but not which; of three, a wrong one is
    found if it disturbs the lengths or angles among them. A row with fewer than two baselines, or
    with all on one line, is not valid. Covariance and tests are those of small errors: with code
    positions (a metre on baselines of a few) they hold no more, and there is no attitude to speak
    of.

    Examples
    --------
    >>> antennas = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0], [-1.0, -1.0, 0.0]])
    >>> measured = np.array(antennas.baselines)
    >>> measured[2, 0] += 0.19  # one wavelength of L1
    >>> fix = gps_attitude(antennas, measured)
    >>> fix.used.tolist(), bool(fix.valid), fix.q.round(6) + 0.0
    ([True, True, False], True, array([1., 0., 0., 0.]))
    """
    if not isinstance(antennas, Antennas):
        raise InputError("must be celestcore.gnss.Antennas", field="antennas", value=antennas)
    n = len(antennas)
    f = array(measured, "measured")
    if f.ndim < 2 or f.shape[-2:] != (n, 3):
        raise InputError(
            f"has shape {f.shape}, needed is (..., {n}, 3): one row for each baseline",
            field="measured",
        )
    leading = f.shape[:-2]
    flat = f.reshape(-1, n, 3)
    full = None if covariance is None else _full(covariance, flat, leading)
    problem = Problem(antennas.baselines, flat, antennas.covariance, full)
    return _result(problem, *_search(problem, _limits(gate, n)), leading)


def _full(covariance: ArrayLike, flat: FloatArray, leading: tuple[int, ...]) -> FloatArray:
    """Return the covariances (m, 3 n, 3 n); of missing baselines they may be anything."""
    c, wide = array(covariance, "covariance"), 3 * flat.shape[1]
    if c.ndim < 2 or c.shape[-2:] != (wide, wide) or c.shape[:-2] not in ((), leading):
        raise InputError(
            f"has shape {c.shape}, needed is ({wide}, {wide}), one for all, or "
            f"{(*leading, wide, wide)}",
            field="covariance",
        )
    stack = np.broadcast_to(c.reshape(-1, wide, wide), (len(flat), wide, wide))
    known = np.repeat(np.asarray(np.isfinite(flat).all(axis=-1)), 3, axis=1)
    stack = np.where(known[:, :, None] & known[:, None, :], stack, np.eye(wide))
    finite = np.asarray(np.isfinite(stack).all(axis=(1, 2)))
    safe = np.where(finite[:, None, None], stack, np.eye(wide))
    turned = np.swapaxes(safe, 1, 2)
    scale = np.abs(safe).max(axis=(1, 2), initial=0.0)
    good = finite & (np.abs(safe - turned).max(axis=(1, 2), initial=0.0) <= 1e-8 * scale)
    safe = 0.5 * (safe + turned)
    good &= np.linalg.eigvalsh(safe)[:, 0] > 0.0
    if not good.all():
        row = int(np.argmin(good))
        raise InputError(
            "must be finite, symmetric and positive definite",
            field="covariance",
            row=None if c.ndim == 2 else row,
        )
    return safe


def _limits(gate: float | None, n: int) -> tuple[float, FloatArray]:
    """Return the limit of each length's square, and of chi-square by number of baselines."""
    if gate is None:
        return np.inf, np.full(n + 1, np.inf)
    p = number(gate, "gate", above=0.0)
    if not p < 1.0:
        raise InputError("must be below 1; None tests nothing", field="gate", value=p)
    risk = 0.5 * (1.0 - p)
    total = np.full(n + 1, np.nan)
    for k in range(2, n + 1):
        total[k] = _core.chi2_quantile(1.0 - risk, 3.0 * k - 3.0)
    return _core.chi2_quantile(1.0 - risk / n, 1.0), total


def _search(problem: Problem, limits: tuple[float, FloatArray]) -> tuple[Fit, BoolArray, BoolArray]:
    """Fit, test, and leave baselines out until the rest passes or none can be spared."""
    m = len(problem.measured)
    used = np.asarray(np.isfinite(problem.measured).all(axis=-1))
    with np.errstate(invalid="ignore"):
        wrong = length_excess(problem) > limits[0]
    best = Fit(np.full((m, 3, 3), np.nan), np.full((m, 3, 3), np.nan), np.full(m, np.nan))
    valid = np.zeros(m, dtype=bool)
    active = np.flatnonzero(observable(problem.body, used))
    while len(active):
        part = problem.rows(active)
        made = fit(part, used[active])
        for whole, new in zip(best, made, strict=True):
            whole[active] = new
        count = used[active].sum(axis=1)
        passed = (made.chi2 <= limits[1][count]) & ~(wrong & used)[active].any(axis=1)
        valid[active] = passed
        active, part = active[~passed], part.rows(~passed)
        chi2, can = leave_one_out(part, used[active])
        spare = can.any(axis=1)
        active = active[spare]
        used[active, np.argmin(chi2[spare], axis=1)] = False
    return best, valid, used


def _result(
    problem: Problem, best: Fit, valid: BoolArray, used: BoolArray, leading: tuple[int, ...]
) -> GpsAttitude:
    n = used.shape[1]
    tried = np.isfinite(best.chi2)
    dof = np.where(tried, 3 * used.sum(axis=1) - 3, 0)
    good = valid[:, None, None]
    q = np.where(valid[:, None], from_matrix(np.where(good, best.matrix, np.eye(3))), np.nan)
    q = q.reshape(*leading, 4)
    p = np.linalg.inv(np.where(good, best.info, np.eye(3)))
    p = 0.5 * (p + np.swapaxes(p, -1, -2))
    return GpsAttitude(
        q=_continuous(q) if leading and q.size else q,
        covariance=np.where(good, p, np.nan).reshape(*leading, 3, 3),
        chi_square=best.chi2.reshape(leading),
        dof=dof.reshape(leading),
        valid=valid.reshape(leading),
        used=(used & valid[:, None]).reshape(*leading, n),
    )
