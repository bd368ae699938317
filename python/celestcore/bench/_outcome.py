"""What a work came to, and whether a peer came to the same: wrong work is refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from celestcore import quaternion
from celestcore.units import ARCSEC

Outcome: TypeAlias = "dict[str, Any]"
"""The result of a work by names: arrays, of one log or of several."""
Agree: TypeAlias = Callable[[Any, Outcome, Outcome], "str | None"]
"""Input of a work, celestcore's outcome and a peer's, to what is wrong with the peer's."""

SIGMAS = 0.05
"""Share by which standard deviations may differ."""


def attitude(arcsec: float) -> Agree:
    """Return a check of attitudes ``q``, and of standard deviations ``sigma`` if there are any."""

    def agree(_: Any, ours: Outcome, theirs: Outcome) -> str | None:
        apart = quaternion.angle_between(ours["q"], theirs["q"])
        worst = float(np.max(apart)) / ARCSEC
        if not worst <= arcsec:
            return f"its attitude is {worst:.3g} arcsec from celestcore's, {arcsec:g} are allowed"
        return _sigmas(ours, theirs)

    return agree


def position(metres: float) -> Agree:
    """Return a check of positions ``r`` [m], and of ``sigma`` if there are any."""

    def agree(_: Any, ours: Outcome, theirs: Outcome) -> str | None:
        worst = float(np.max(np.linalg.norm(np.subtract(ours["r"], theirs["r"]), axis=-1)))
        if not worst <= metres:
            return f"its position is {worst:.3g} m from celestcore's, {metres:g} are allowed"
        return _sigmas(ours, theirs)

    return agree


def acceleration(relative: float) -> Agree:
    """Return a check of accelerations ``a``."""

    def agree(_: Any, ours: Outcome, theirs: Outcome) -> str | None:
        size = np.linalg.norm(ours["a"], axis=-1)
        off = np.linalg.norm(np.subtract(ours["a"], theirs["a"]), axis=-1) / size
        worst = float(np.max(off))
        if worst <= relative:
            return None
        return f"its acceleration is off by {worst:.2g} of celestcore's, {relative:g} are allowed"

    return agree


def systematic(weights: Any, ours: Outcome, theirs: Outcome) -> str | None:
    """Check that each particle is drawn n w times, rounded up or down."""
    del ours
    counts = np.bincount(np.asarray(theirs["chosen"], dtype=np.int64), minlength=len(weights))
    worst = float(np.max(np.abs(counts - len(weights) * weights)))
    return None if worst < 1.0 + 1e-6 else f"a particle was drawn {worst:.3g} times too often"


def residual(weights: Any, ours: Outcome, theirs: Outcome) -> str | None:
    """Check that each particle is drawn at least as often as n w says, rounded down."""
    counts = np.bincount(np.asarray(theirs["chosen"], dtype=np.int64), minlength=len(weights))
    least = np.floor(len(weights) * weights * (1.0 - 1e-9))
    if np.any(counts < least):
        return "a particle was drawn too seldom"
    return multinomial(weights, ours, theirs)


def multinomial(weights: Any, ours: Outcome, theirs: Outcome) -> str | None:
    """Check how many are drawn, and their distribution (Kolmogorov and Smirnov)."""
    del ours
    chosen = np.asarray(theirs["chosen"], dtype=np.int64)
    n = len(weights)
    if len(chosen) != n:
        return f"{len(chosen)} particles were drawn instead of {n}"
    counts = np.bincount(chosen, minlength=n)
    worst = float(np.max(np.abs(np.cumsum(counts / n - weights)))) * np.sqrt(n)
    return None if worst < 3.0 else f"draws do not go by the weights (distance {worst:.3g})"


def _sigmas(ours: Outcome, theirs: Outcome) -> str | None:
    if "sigma" not in ours or "sigma" not in theirs:
        return None
    worst = float(np.max(np.abs(np.divide(theirs["sigma"], ours["sigma"]) - 1.0)))
    if worst <= SIGMAS:
        return None
    return (
        f"its sigmas are off by {100 * worst:.3g} % of celestcore's, {100 * SIGMAS:g} are allowed"
    )
