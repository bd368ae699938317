"""Errors of simulated GNSS fixes and star fixes, each source with random numbers of its own."""

from __future__ import annotations

import numpy as np

from celestcore._check import BoolArray, FloatArray, array
from celestcore.errors import InputError

SOURCES = (
    "attitude",
    "lfe",
    "star",
    "star_markov",
    "star_outliers",
    "gnss_position",
    "gnss_velocity",
    "gnss_markov",
    "gnss_outliers",
    "baselines",
)
"""The order is part of every trial: new sources go to the end."""

Pair = tuple[float, float]
Outliers = tuple[float, float, float]


def streams(seed: int, trial: int) -> dict[str, np.random.Generator]:
    """Return a generator for each source of errors of one trial."""
    parts = np.random.SeedSequence((seed, trial)).spawn(len(SOURCES))
    return {name: np.random.default_rng(s) for name, s in zip(SOURCES, parts, strict=True)}


def pair_of(value: Pair | None, field: str) -> Pair | None:
    """Return (sigma, correlation time), checked."""
    if value is None:
        return None
    pair = array(value, field, (2,))
    if not (np.isfinite(pair).all() and pair[0] >= 0.0 and pair[1] > 0.0):
        raise InputError("needs (sigma, correlation time [s])", field=field, value=pair)
    return float(pair[0]), float(pair[1])


def outliers_of(value: Outliers | None, field: str) -> Outliers | None:
    """Return (fraction, lowest, highest), checked."""
    if value is None:
        return None
    three = array(value, field, (3,))
    fraction, low, high = three.tolist()
    if not (0.0 <= fraction <= 1.0 and 0.0 <= low <= high < np.inf):
        raise InputError(
            "needs (fraction, lowest, highest), these in 1-sigmas", field=field, value=three
        )
    return fraction, low, high


def markov(rng: np.random.Generator, t: FloatArray, kind: Pair | None) -> FloatArray:
    """Return a stationary first-order Gauss-Markov process of three axes (n, 3).

    Exact for any spacing (Gillespie, Phys. Rev. E 54, 1996).
    """
    drawn = rng.standard_normal((len(t), 3))
    if kind is None:
        return np.zeros((len(t), 3))
    sigma, tau = kind
    keep = np.exp(-np.diff(t) / tau)
    fresh = np.sqrt(-np.expm1(-2.0 * np.diff(t) / tau))
    out = np.empty((len(t), 3))
    out[0] = drawn[0]
    for k in range(1, len(t)):
        out[k] = keep[k - 1] * out[k - 1] + fresh[k - 1] * drawn[k]
    return sigma * out


def outliers(
    rng: np.random.Generator, n: int, kind: Outliers | None
) -> tuple[BoolArray, FloatArray]:
    """Return which rows are hit, and by how much in 1-sigmas: two random vectors each (n, 2, 3)."""
    hit, size = rng.random(n), rng.random(n)
    way = rng.standard_normal((n, 2, 3))
    if kind is None:
        return np.zeros(n, dtype=bool), np.zeros((n, 2, 3))
    fraction, low, high = kind
    way /= np.linalg.norm(way, axis=2, keepdims=True)
    wrong = hit < fraction
    length = np.where(wrong, low + (high - low) * size, 0.0)
    return wrong, length[:, None, None] * way


def harmonics(coefficients: FloatArray, angle: FloatArray) -> FloatArray:
    """Return the low-frequency error (n, 3): sum over k of c_k cos(k angle) + s_k sin(k angle).

    Coefficients are (harmonics, 2, 3): cosine and sine for each axis.
    """
    k = np.arange(1, len(coefficients) + 1)
    turn = angle[:, None] * k
    shape = np.stack([np.cos(turn), np.sin(turn)], axis=2)
    return np.asarray(np.einsum("nkj,kja->na", shape, coefficients))


def random_harmonics(rng: np.random.Generator, amplitudes: tuple[float, ...]) -> FloatArray:
    """Return coefficients (harmonics, 2, 3) of given amplitude and random phase per axis."""
    phase = 2.0 * np.pi * rng.random((len(amplitudes), 3))
    size = np.array(amplitudes)[:, None]
    return np.stack([size * np.cos(phase), size * np.sin(phase)], axis=1)
