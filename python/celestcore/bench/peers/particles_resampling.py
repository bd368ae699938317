"""particles: `particles.resampling`."""

from __future__ import annotations

from collections.abc import Callable

from celestcore._check import FloatArray
from celestcore.bench._outcome import Outcome


def _call(way: str, weights: FloatArray) -> Callable[[], Outcome]:
    from particles import resampling

    return lambda: {"chosen": resampling.resampling(way, weights)}


def systematic(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of systematic resampling."""
    return _call("systematic", weights)


def multinomial(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of multinomial resampling."""
    return _call("multinomial", weights)


def residual(weights: FloatArray) -> Callable[[], Outcome]:
    """Return a call of residual resampling."""
    return _call("residual", weights)
