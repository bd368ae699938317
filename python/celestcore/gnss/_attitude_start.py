"""Which of the first attitude fixes agree: a wrong one must not start the filter."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from celestcore import quaternion
from celestcore._check import BoolArray, FloatArray, IntArray

FIRST = 8
"""How many fixes are looked at."""
LIMIT = 21.1
"""Chi-square of three components that one good fix in ten thousand exceeds."""


def agreeing(
    t: FloatArray, q: FloatArray, sigma: FloatArray, jerk_psd: float, degree: int
) -> BoolArray:
    """Say which fixes the majority agrees with.

    Every set of `degree` + 1 fixes makes a curve of that degree; the one under which all fixes are
    most likely, those that are off it taken as wrong, tells the good from the bad: a curve through
    fixes that lie close together is near every fix but makes none likely. All are good if none of
    the curves has a majority.

    Parameters
    ----------
    t : ndarray (n,)
        Times [s].
    q : ndarray (n, 4)
        Attitudes in a frame in which the body hardly turns.
    sigma : ndarray (n,)
        1-sigma [rad].
    jerk_psd : float
        What the curve leaves out [rad^2/s^5].
    degree : int
        2 with a kinematic model; 1 where a gyro's turns have been taken out.

    Returns
    -------
    ndarray of bool (n,)
    """
    n, order = len(t), degree + 1
    if n < order + 2:
        return np.ones(n, bool)
    turns = quaternion.log(quaternion.multiply(quaternion.conjugate(q[n // 2]), q))
    some = np.array(list(combinations(range(n), order)))
    weights, apart = _lagrange((t - t[0]) / max(float(t[-1] - t[0]), 1e-9), some)
    some, weights = some[apart], weights[apart]
    if not len(some):
        return np.ones(n, bool)
    away = np.abs(t[:, None] - t[some][:, None, :]).max(axis=2)
    spread = np.einsum("cnj,cj->cn", weights**2, sigma[some] ** 2)
    variance = sigma**2 + spread + jerk_psd * away**5 / 20.0
    chi2 = ((turns - weights @ turns[some]) ** 2).sum(axis=2) / variance
    good = chi2 < LIMIT
    likely = np.where(good, chi2 + 3.0 * np.log(variance / sigma**2), LIMIT)
    chosen = good[np.argmin(np.minimum(likely, LIMIT).sum(axis=1))]
    count = int(chosen.sum())
    return chosen if 2 * count > n and count > order else np.ones(n, bool)


def _lagrange(t: FloatArray, some: IntArray) -> tuple[FloatArray, BoolArray]:
    """Return weights (c, n, k) of k nodes at all times, and which sets have nodes apart (c,)."""
    nodes = t[some]
    order = nodes.shape[1]
    weights = np.ones((len(some), len(t), order))
    apart = np.ones(len(some), bool)
    for j in range(order):
        for k in range(order):
            if k != j:
                between = nodes[:, j] - nodes[:, k]
                apart &= np.abs(between) > 1e-9
                safe = np.where(between == 0.0, 1.0, between)
                weights[:, :, j] *= (t - nodes[:, k : k + 1]) / safe[:, None]
    return weights, apart
