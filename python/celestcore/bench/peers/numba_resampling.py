"""numba: resampling as loops."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from celestcore.bench._outcome import Outcome
from celestcore.bench.peers._compiled import compiled

Array = Any


@compiled
def draw_systematic(w: Array, u: float, out: Array) -> None:
    """Write the particle in whose share of the sum each of equally spaced points lies."""
    n, last, k, reached = len(out), len(w) - 1, 0, w[0]
    for i in range(n):
        point = (i + u) / n
        while point >= reached and k < last:
            k += 1
            reached += w[k]
        out[i] = k


@compiled
def _sorted_draws(w: Array, total: float, out: Array) -> None:
    """Independent draws in order: sums of exponential numbers are sorted uniform ones."""
    n, last = len(out), len(w) - 1
    points = np.empty(n + 1)
    s = 0.0
    for i in range(n + 1):
        s -= math.log(1.0 - np.random.random())  # noqa: NPY002
        points[i] = s
    k, reached = 0, w[0]
    for i in range(n):
        point = points[i] / s * total
        while point >= reached and k < last:
            k += 1
            reached += w[k]
        out[i] = k


@compiled
def _residual(w: Array, out: Array) -> None:
    n, filled, total = len(out), 0, 0.0
    rest = np.empty(len(w))
    for k in range(len(w)):
        copies = math.floor(n * w[k])
        rest[k] = n * w[k] - copies
        total += rest[k]
        for _ in range(copies):
            out[filled] = k
            filled += 1
    _sorted_draws(rest, total, out[filled:])


def _call(draw: Callable[[Array], None], weights: Array) -> Callable[[], Outcome]:
    out = np.empty(len(weights), np.int64)

    def call() -> Outcome:
        draw(out)
        return {"chosen": out}

    return call


def systematic(weights: Array) -> Callable[[], Outcome]:
    """Return a call of systematic resampling."""
    return _call(lambda out: draw_systematic(weights, 0.37, out), weights)


def multinomial(weights: Array) -> Callable[[], Outcome]:
    """Return a call of multinomial resampling."""
    return _call(lambda out: _sorted_draws(weights, 1.0, out), weights)


def residual(weights: Array) -> Callable[[], Outcome]:
    """Return a call of residual resampling."""
    return _call(lambda out: _residual(weights, out), weights)
