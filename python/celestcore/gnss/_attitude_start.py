"""Which of the first attitude fixes agree: a wrong one must not start the filter."""

from __future__ import annotations

from itertools import combinations

import numpy as np

from celestcore import quaternion
from celestcore._check import BoolArray, FloatArray

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
    middle = q[n // 2]
    turns = quaternion.log(quaternion.multiply(quaternion.conjugate(middle), q))
    scaled = (t - t[0]) / max(float(t[-1] - t[0]), 1e-9)
    best, chosen = -np.inf, np.ones(n, bool)
    for some in map(list, combinations(range(n), order)):
        nodes = scaled[some]
        apart = nodes[:, None] - nodes + np.eye(order)
        if np.abs(apart).min() < 1e-9:
            continue
        weights = np.array(
            [
                np.prod((scaled[:, None] - np.delete(nodes, j)) / np.delete(apart[j], j), axis=1)
                for j in range(order)
            ]
        ).T
        away = np.abs(t[:, None] - t[some]).max(axis=1)
        variance = sigma**2 + weights**2 @ sigma[some] ** 2 + jerk_psd * away**5 / 20.0
        chi2 = ((turns - weights @ turns[some]) ** 2).sum(axis=1) / variance
        good = chi2 < LIMIT
        likely = np.where(good, chi2 + 3.0 * np.log(variance / sigma**2), LIMIT)
        score = -float(np.minimum(likely, LIMIT).sum())
        if score > best:
            best, chosen = score, good
    count = int(chosen.sum())
    return chosen if 2 * count > n and count > order else np.ones(n, bool)
