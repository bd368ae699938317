"""filterpy: `filterpy.monte_carlo`."""

from __future__ import annotations

from collections.abc import Callable

from celestcore._check import FloatArray
from celestcore.bench._outcome import Outcome


def systematic(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of systematic resampling."""
    from filterpy.monte_carlo import systematic_resample

    return lambda: {"chosen": systematic_resample(weights)}


def multinomial(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of multinomial resampling."""
    from filterpy.monte_carlo import multinomial_resample

    return lambda: {"chosen": multinomial_resample(weights)}


def residual(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of residual resampling."""
    from filterpy.monte_carlo import residual_resample

    return lambda: {"chosen": residual_resample(weights)}
