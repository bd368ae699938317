"""A small maximiser for a few parameters, and the curvature at the top."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Function = Callable[[Array], float]

_DROP = (0.25, 2.5)
"""By how much a log-likelihood should fall over the steps of its second differences."""


def maximise(
    f: Function, start: Array, step: float, *, tolerance: float = 1e-4, evaluations: int = 400
) -> tuple[Array, float]:
    """Return the top of `f` near `start`, and its height there.

    Nelder and Mead, *A simplex method for function minimization*, Computer Journal 7 (1965): stops
    when the simplex is flat to `tolerance` and small, or very flat whatever its size.
    """
    n = len(start)
    x = np.vstack([start, start + step * np.eye(n)])
    y = np.array([f(p) for p in x])
    used = n + 1
    while used < evaluations:
        order = np.argsort(-y, kind="stable")
        x, y = x[order], y[order]
        spread = y[0] - y[-1]
        if spread < tolerance and (np.ptp(x, axis=0).max() < 0.02 or spread < 0.01 * tolerance):
            break
        centre = x[:-1].mean(axis=0)
        tried = 2.0 * centre - x[-1]
        value = f(tried)
        used += 1
        if value > y[0]:
            far = 3.0 * centre - 2.0 * x[-1]
            further = f(far)
            used += 1
            x[-1], y[-1] = (far, further) if further > value else (tried, value)
        elif value > y[-2]:
            x[-1], y[-1] = tried, value
        else:
            inner = 0.5 * (centre + (tried if value > y[-1] else x[-1]))
            nearer = f(inner)
            used += 1
            if nearer > max(value, y[-1]):
                x[-1], y[-1] = inner, nearer
            else:
                x[1:] = 0.5 * (x[1:] + x[0])
                y[1:] = [f(p) for p in x[1:]]
                used += n
    best = int(np.argmax(y))
    return x[best].copy(), float(y[best])


def curvature(f: Function, top: Array, height: float) -> Array:
    """Return minus the second derivatives of a log-likelihood at its top.

    By differences over steps that cost about one unit: a step much smaller would drown in rounding,
    and the steps are what error bars are about.
    """
    n = len(top)
    step = np.array([_step(f, top, height, k) for k in range(n)])
    out = np.empty((n, n))
    for i in range(n):
        for j in range(i + 1):
            a, b = step[i] * np.eye(n)[i], step[j] * np.eye(n)[j]
            if i == j:
                out[i, i] = (2.0 * height - f(top + a) - f(top - a)) / step[i] ** 2
                continue
            same = f(top + a + b) + f(top - a - b)
            other = f(top + a - b) + f(top - a + b)
            out[i, j] = out[j, i] = (other - same) / (4.0 * step[i] * step[j])
    return out


def _step(f: Function, top: Array, height: float, k: int) -> float:
    """Return a step along parameter `k` over which `f` falls by about one."""
    unit, step = np.eye(len(top))[k], 0.1
    for _ in range(20):
        drop = height - 0.5 * (f(top + step * unit) + f(top - step * unit))
        if _DROP[0] <= drop <= _DROP[1]:
            break
        step *= float(np.clip(1.0 / np.sqrt(max(drop, 0.01)), 0.1, 4.0))
        if step > 3.0:
            return 3.0
    return step
