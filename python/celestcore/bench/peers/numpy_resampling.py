"""numpy: resampling by whole arrays."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celestcore._check import FloatArray
from celestcore.bench._outcome import Outcome


def systematic(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of systematic resampling: points looked up in the sums of the weights."""
    n, random = len(weights), np.random.default_rng(3)

    def call() -> Outcome:
        reached = np.cumsum(weights)
        reached[-1] = 1.0
        points = (np.arange(n) + random.random()) / n
        return {"chosen": np.searchsorted(reached, points, side="right")}

    return call


def multinomial(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of multinomial resampling."""
    n, random = len(weights), np.random.default_rng(3)
    return lambda: {"chosen": random.choice(n, n, p=weights)}


def residual(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of residual resampling."""
    n, random = len(weights), np.random.default_rng(3)

    def call() -> Outcome:
        copies = np.floor(n * weights)
        kept = np.repeat(np.arange(n), copies.astype(np.int64))
        rest = n * weights - copies
        drawn = random.choice(n, n - len(kept), p=rest / rest.sum())
        return {"chosen": np.concatenate([kept, drawn])}

    return call
