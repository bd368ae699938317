"""The search for the orbit that most fixes agree on."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np

from celestcore._check import BoolArray, FloatArray
from celestcore.errors import CelestcoreError
from celestcore.orbit import ForceModel, propagate

MODEL = 1e-4
"""Acceleration [m/s^2] that J2 leaves out in low orbits, with a margin."""
LIMIT = {3: 21.11, 6: 27.86}
"""Chi-square that one good fix in ten thousand exceeds, by the degrees of freedom."""
LONGEST = 900.0
"""Longest time between two positions that make an orbit [s]: far below half a revolution."""
PAIRS = 200
REFINED = 4
"""How many of the best candidates are refined."""
_SHOTS = 6
_STEPS = 6
_RTOL = 1e-11


@dataclass(frozen=True)
class Fixes:
    """What is given: fixes, their noise and the model of the motion."""

    t: FloatArray
    z: FloatArray
    """Positions, or positions and velocities (n, m)."""
    noise: FloatArray
    """1-sigma (m,)."""
    force: ForceModel
    tables: dict[str, Any] | None
    slack: float

    def states(self, k: int, state: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return states (n, 6) at all times and their derivatives to that at time k (n, 6, 6)."""
        n = len(self.t)
        states, stm = np.empty((n, 6)), np.empty((n, 6, 6))
        for rows in (np.arange(k, n), np.arange(k, -1, -1)):
            made = propagate(
                self.force,
                None,
                state[:3],
                state[3:],
                self.t[rows],
                stm=True,
                rtol=_RTOL,
                environment=self.tables,
            )
            assert made.stm is not None
            states[rows], stm[rows] = made.state, made.stm
        return states, stm

    def variance(self, since: FloatArray) -> FloatArray:
        """Return variances of measurements (n, m), the model's error over a time included."""
        gone = np.abs(since)[:, None]
        position, velocity = 0.5 * self.slack * gone**2, self.slack * gone
        error = np.hstack([np.repeat(position, 3, axis=1), np.repeat(velocity, 3, axis=1)])
        return np.asarray(self.noise**2 + error[:, : len(self.noise)] ** 2)


class Candidate(NamedTuple):
    """An orbit by its state at the time of fix k, and the uncertainty of that state."""

    k: int
    state: FloatArray
    covariance: FloatArray
    other: int
    """The other fix that it rests on, or k."""


class Agreed(NamedTuple):
    """An orbit by its state at the first time, and who agrees."""

    first: FloatArray
    good: BoolArray
    cost: float


class Consensus:
    """Candidates, who agrees with them, and the refined orbit of those."""

    def __init__(self, fixes: Fixes) -> None:
        self.fixes = fixes
        self.n, self.m = fixes.z.shape
        self.limit = LIMIT[self.m]

    def best(self) -> Agreed | None:
        """Return the orbit that most fixes agree with, of equals the closest; None: no orbit."""
        sets: dict[tuple[bool, ...], tuple[int, float, Candidate]] = {}
        for candidate in self._candidates():
            try:
                good, cost = self._agreeing(candidate)
            except CelestcoreError:
                continue  # it leads into the Earth: no orbit of a satellite
            key = tuple(good.tolist())
            rank = (int(good.sum()), -cost, candidate)
            if key not in sets or rank[:2] > sets[key][:2]:
                sets[key] = rank
            if good.all():
                break  # no other candidate can have more, and the fit to all is the same
        ranked = sorted(sets.items(), key=lambda item: item[1][:2], reverse=True)
        refined = []
        for key, (_, _, candidate) in ranked[:REFINED]:
            try:
                refined.append(self._refined(np.array(key), candidate))
            except (CelestcoreError, np.linalg.LinAlgError):
                continue
        return max(refined, key=lambda a: (int(a.good.sum()), -a.cost), default=None)

    def _candidates(self) -> Iterator[Candidate]:
        z, noise = self.fixes.z, self.fixes.noise
        if self.m == 6:
            for k in range(self.n):
                yield Candidate(k, z[k], np.diag(noise**2), k)
            return
        t = self.fixes.t
        pairs = [(i, j) for i, j in combinations(range(self.n), 2) if t[j] - t[i] <= LONGEST]
        for i, j in pairs[:: 1 + len(pairs) // PAIRS]:
            try:
                made = self._through(i, j)
            except (CelestcoreError, np.linalg.LinAlgError):
                continue
            if made is not None:
                yield made

    def _through(self, i: int, j: int) -> Candidate | None:
        """Return the orbit through two positions, by shooting; None if it finds none."""
        fixes = self.fixes
        a, b, dt = fixes.z[i], fixes.z[j], float(fixes.t[j] - fixes.t[i])
        radius, mu = float(np.linalg.norm(a)), fixes.force.mu
        v = (b - a) / dt + 0.5 * mu * a / radius**3 * dt
        times = np.array([0.0, dt]) + fixes.t[i]
        for _ in range(_SHOTS):
            if not np.linalg.norm(v) < 2.0 * np.sqrt(2.0 * mu / radius):
                return None
            made = propagate(
                fixes.force, None, a, v, times, stm=True, rtol=_RTOL, environment=fixes.tables
            )
            assert made.stm is not None
            miss, stm = b - made.r[1], made.stm[1]
            step = np.linalg.solve(stm[:3, 3:], miss)
            v = v + step
            if np.linalg.norm(miss) < 1e-3 * fixes.noise[0]:
                break
        else:
            return None
        by_b = np.linalg.inv(stm[:3, 3:])
        jacobian = np.block([[np.eye(3), np.zeros((3, 3))], [-by_b @ stm[:3, :3], by_b]])
        covariance = fixes.noise[0] ** 2 * jacobian @ jacobian.T
        return Candidate(i, np.r_[a, v], covariance, j)

    def _agreeing(self, c: Candidate) -> tuple[BoolArray, float]:
        """Return who agrees with a candidate, and the chi-squares of those together."""
        fixes = self.fixes
        states, stm = fixes.states(c.k, c.state)
        since = np.maximum(np.abs(fixes.t - fixes.t[c.k]), np.abs(fixes.t - fixes.t[c.other]))
        rows = stm[:, : self.m]
        spread = rows @ c.covariance @ np.swapaxes(rows, 1, 2)
        spread += fixes.variance(since)[:, :, None] * np.eye(self.m)
        d2 = _chi_square(fixes.z - states[:, : self.m], spread)
        good = d2 < self.limit
        return good, float(d2[good].sum())

    def _refined(self, good: BoolArray, c: Candidate) -> Agreed:
        """Fit the orbit to those that agree until nobody joins or leaves any more."""
        middle = int(np.flatnonzero(good)[int(good.sum()) // 2])
        state = self.fixes.states(c.k, c.state)[0][middle]
        seen: set[tuple[bool, ...]] = set()
        while True:
            state, states, d2 = self._fit(good, middle, state)
            cost = float(d2[good].sum())
            agreed = Agreed(states[0], good, cost)
            worst = int(np.argmax(np.where(good, d2, -1.0)))
            changed = good | (d2 < self.limit)
            if d2[worst] >= self.limit:
                changed = good.copy()
                changed[worst] = False
            key = tuple(changed.tolist())
            if (changed == good).all() or key in seen or not changed.any():
                return agreed
            seen.add(key)
            good = changed

    def _fit(
        self, good: BoolArray, k: int, state: FloatArray
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return the least-squares state at time k, all states, and the chi-squares of all fixes.

        The chi-square of a fix that is in the fit is that against the fit without it.
        """
        fixes = self.fixes
        variance = fixes.variance(fixes.t - fixes.t[k])
        for _ in range(_STEPS):
            states, stm = fixes.states(k, state)
            white = (fixes.z - states[:, : self.m]) / np.sqrt(variance)
            rows = stm[:, : self.m] / np.sqrt(variance)[:, :, None]
            step, *_ = np.linalg.lstsq(
                rows[good].reshape(-1, 6) * _SCALE, white[good].reshape(-1), rcond=None
            )
            state = state + step * _SCALE
            if np.abs(step).max() < 1e-4 * fixes.noise[0]:
                break
        states, stm = fixes.states(k, state)
        white = (fixes.z - states[:, : self.m]) / np.sqrt(variance)
        rows = stm[:, : self.m] / np.sqrt(variance)[:, :, None] * _SCALE
        stacked = rows[good].reshape(-1, 6)
        covariance = np.linalg.inv(stacked.T @ stacked)
        lever = rows @ covariance @ np.swapaxes(rows, 1, 2)
        sign = np.where(good, -1.0, 1.0)[:, None, None]
        return state, states, _chi_square(white, np.eye(self.m) + sign * lever)


_SCALE = np.array([1.0, 1.0, 1.0, 1e-2, 1e-2, 1e-2])
"""Sizes of a step in position [m] and velocity [m/s] that are alike."""


def _chi_square(e: FloatArray, spread: FloatArray) -> FloatArray:
    """Return e' spread^-1 e, rows (n,); what has no spread at all does not count."""
    values, axes = np.linalg.eigh(spread)
    along = np.einsum("nij,ni->nj", axes, e)
    firm = values > 1e-9 * values.max(axis=1, keepdims=True)
    return np.asarray((along**2 / np.where(firm, values, np.inf)).sum(axis=1))
