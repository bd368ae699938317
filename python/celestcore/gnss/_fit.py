"""Stacks of baseline fits: maximum-likelihood attitude, its information and its chi-square."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from celestcore._check import BoolArray, FloatArray, IntArray
from celestcore.errors import NumericalError
from celestcore.gnss.antennas import cross_matrix, information, observable
from celestcore.quaternion import exp, to_matrix

_STEPS = 30
_CONVERGED = 1e-12


class Problem(NamedTuple):
    """Baselines of one spacecraft at many times.

    ``body`` (n, 3) and ``measured`` (m, n, 3) [m]; ``axis`` (n, n) [m^2], the covariance about each
    axis; ``full`` (m, 3 n, 3 n) [m^2] in the measured frame, or None.
    """

    body: FloatArray
    measured: FloatArray
    axis: FloatArray
    full: FloatArray | None

    def rows(self, index: IntArray | BoolArray) -> Problem:
        """Return some of the times, also repeated ones."""
        full = None if self.full is None else self.full[index]
        return self._replace(measured=self.measured[index], full=full)


class Fit(NamedTuple):
    """Attitudes ``matrix`` (m, 3, 3) body to measured frame, ``info`` (m, 3, 3), ``chi2`` (m,)."""

    matrix: FloatArray
    info: FloatArray
    chi2: FloatArray


def fit(problem: Problem, used: BoolArray) -> Fit:
    """Find the attitudes of the baselines that are used (m, n); each row must be observable."""
    f = np.where(used[..., None], problem.measured, 0.0)
    weights = axis_weights(problem.axis, used)
    matrix = _procrustes(problem.body, f, weights)
    if problem.full is not None:
        return _refine(problem, f, used, matrix)
    rest = f - problem.body @ np.swapaxes(matrix, -1, -2)
    chi2 = np.einsum("mij,mik,mjk->m", weights, rest, rest)
    return Fit(matrix, information(problem.body, weights), np.asarray(chi2))


def axis_weights(axis: FloatArray, used: BoolArray) -> FloatArray:
    """Return the inverses (m, n, n) of the covariances of the baselines used, zero elsewhere."""
    masks, which = np.unique(used, axis=0, return_inverse=True)
    return masked_inverse(np.broadcast_to(axis, (len(masks), *axis.shape)), masks)[which.ravel()]


def masked_inverse(covariance: FloatArray, keep: BoolArray) -> FloatArray:
    """Invert the rows and columns (m, k) of (m, k, k) that are kept; the others become zero."""
    both = keep[:, :, None] & keep[:, None, :]
    inside = np.where(both, covariance, np.eye(covariance.shape[-1]))
    return np.where(both, np.linalg.inv(inside), 0.0)


def _procrustes(body: FloatArray, f: FloatArray, weights: FloatArray) -> FloatArray:
    """Turn that minimises ``sum W_ij (f_i - A b_i) . (f_j - A b_j)`` (Markley 1988, by SVD)."""
    profile = np.einsum("mij,mia,jb->mab", weights, f, body)
    u, _, vt = np.linalg.svd(profile)
    last = np.linalg.det(u) * np.linalg.det(vt)
    u[..., 2] *= last[:, None]
    return np.asarray(u @ vt)


def _refine(problem: Problem, f: FloatArray, used: BoolArray, matrix: FloatArray) -> Fit:
    """Gauss-Newton with the full covariance, error on the right: ``A exp([d]x)``."""
    assert problem.full is not None
    m, n = used.shape
    weights = masked_inverse(problem.full, np.repeat(used, 3, axis=1))
    lever = cross_matrix(problem.body)
    for _ in range(_STEPS):
        rest = (f - problem.body @ np.swapaxes(matrix, -1, -2)).reshape(m, 3 * n, 1)
        jacobian = (matrix[:, None] @ lever).reshape(m, 3 * n, 3)
        across = np.swapaxes(jacobian, -1, -2) @ weights
        info = across @ jacobian
        step = -np.linalg.solve(info, across @ rest)[..., 0]
        if not np.abs(step).max(initial=0.0) > _CONVERGED:
            chi2 = np.swapaxes(rest, -1, -2) @ weights @ rest
            return Fit(matrix, info, chi2[:, 0, 0])
        matrix = matrix @ to_matrix(exp(step))
    raise NumericalError(
        f"the attitude does not settle with the full covariance in {_STEPS} iterations: "
        "is it positive definite, and small against the baselines?"
    )


def length_excess(problem: Problem) -> FloatArray:
    """Return the squared errors in length over their variance (m, n); NaN where missing."""
    length = np.linalg.norm(problem.measured, axis=-1)
    known = np.linalg.norm(problem.body, axis=-1)
    if problem.full is None:
        variance = np.broadcast_to(np.diagonal(problem.axis), length.shape)
    else:
        with np.errstate(all="ignore"):
            along = problem.measured / length[..., None]
        k = np.arange(len(known))
        blocks = problem.full.reshape(len(length), len(k), 3, len(k), 3)[:, k, :, k]
        variance = np.einsum("mia,imab,mib->mi", along, blocks, along)
    return np.asarray((length - known) ** 2 / variance)


def leave_one_out(problem: Problem, used: BoolArray) -> tuple[FloatArray, BoolArray]:
    """Return chi-square (m, n) without each baseline, infinite where it cannot be spared."""
    m, n = used.shape
    without = used[:, None, :] & ~np.eye(n, dtype=bool)
    can = used & observable(problem.body, without)
    row, which = np.nonzero(can)
    chi2 = np.full((m, n), np.inf)
    if len(row):
        chi2[row, which] = fit(problem.rows(row), without[row, which]).chi2
    return chi2, can
