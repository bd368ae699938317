"""A made-up solution that looks like a real one."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from celestcore.analysis import WithheldDrift
from celestcore.solution import Solution
from celestcore.units import ARCSEC, DEG_PER_HOUR

MakeSolution = Callable[..., Solution]


def make(n: int = 2001, *, seed: int = 1, sensors: int = 1, **changes: Any) -> Solution:
    """Return n rows at 1 Hz: a turn about a tilted axis, a fix every other sample."""
    rng = np.random.default_rng(seed)
    t = np.arange(n, dtype=float)
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    half = 0.5 * 1.1e-3 * t
    q = np.column_stack([np.cos(half), np.sin(half)[:, None] * axis])
    settle = np.exp(-t / 100.0)[:, None]
    sigma = np.hstack(
        [
            ARCSEC * (3.0 + 40.0 * settle) * np.array([1.0, 1.2, 3.0]),
            DEG_PER_HOUR * (0.05 + 1.0 * settle) * np.ones(3),
        ]
    )
    bias = DEG_PER_HOUR * np.array([0.3, -0.2, 0.8]) + 0.3 * sigma[:, 3:] * np.sin(t / 200)[:, None]
    fix_t = t[1::2]
    m = len(fix_t)
    spread = np.tile(ARCSEC * np.array([6.0, 7.0, 18.0]), (m, 1))
    innovation = spread * rng.standard_normal((m, 3))
    accepted = np.ones(m, dtype=bool)
    innovation[m // 2 :: 97] *= 9.0
    accepted[m // 2 :: 97] = False
    sensor = np.arange(m) % sensors
    dof = np.where(sensor == 2, 2, 3)
    innovation[dof == 2, 2] = np.nan
    spread[dof == 2, 2] = np.nan
    gaps = np.array([[0.4 * n, 0.45 * n]])
    used = int(accepted.sum())
    counts = {"samples": n, "fixes": m, "accepted": used, "rejected": m - used}
    columns: dict[str, Any] = {
        "t": t,
        "q": q,
        "rate": np.tile(1.1e-3 * axis, (n, 1)),
        "bias": bias,
        "sigma": sigma,
        "measurement_t": fix_t,
        "sensor": sensor,
        "nis": np.nansum((innovation / spread) ** 2, axis=1),
        "dof": dof,
        "accepted": accepted,
        "innovation": innovation,
        "innovation_sigma": spread,
        "gaps": gaps,
        "counts": {**counts, "missing": 4, "outside": 1, "gaps": 1},
        "sensor_names": ["star", "star_1", "vector_sun"][:sensors],
        "epoch": "2026-01-01T00:00:00",
        "title": "Made-up satellite",
        "filter": "ekf",
        "elapsed_s": 1e-3,
        "final": {"t": t[-1], "q": q[-1], "bias": bias[-1], "sigma": sigma[-1]},
    }
    return Solution(**{**columns, **changes})


@pytest.fixture
def make_solution() -> MakeSolution:
    """Return the function that builds made-up solutions."""
    return make


@pytest.fixture
def solution() -> Solution:
    """Return a made-up solution of 2001 rows and 1000 fixes, 11 or so of them rejected."""
    return make()


@pytest.fixture
def drift() -> WithheldDrift:
    """Return a made-up test of 40 windows of 600 s, the first 3 of them beyond 3 sigma."""
    k = np.arange(40)
    drifted = ARCSEC * (10.0 + k)
    sigma = np.where(k < 3, drifted / 4.0, drifted / 2.0)
    return WithheldDrift(
        window=600.0,
        start=600.0 * k,
        drift=drifted,
        drift_without_bias=3.0 * drifted,
        sigma=sigma,
        ratio=drifted / sigma,
        distance=drifted / sigma,
        fold=k // 10,
        arw=np.full(40, 1e-6),
        rrw=np.full(40, 1e-9),
    )
