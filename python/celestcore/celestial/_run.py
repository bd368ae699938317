"""What a celestial navigator's runs have in common: options, times, a start, and the answer."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import LARGEST, positive
from celestcore._check import FloatArray, array, number, times, warn
from celestcore.celestial.log import CelestialLog
from celestcore.celestial.solution import OrbitSolution
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.celestial.navigator import CelestialNavigator

Sigma0: TypeAlias = "tuple[ArrayLike, ArrayLike]"
START_SIGMA = (1e3, 1.0)
"""1-sigma of a start's position [m] and velocity [m/s] if none is given."""

DEFAULTS: dict[str, Any] = {
    "sigma0": None,
    "covariance0": None,
    "t0": None,
    "t_output": None,
    "every": 1,
    "covariance": False,
    "environment": None,
    "seed": 0,
    "trial": 0,
    "portable": False,
    "progress": None,
}


def stops(epochs: FloatArray, t0: float | None, t_output: ArrayLike | None) -> FloatArray:
    """Return the times that a run stops at: the start first."""
    if not len(epochs) and t0 is None:
        raise InputError("is needed where a log has no angle", field="t0")
    begin = float(epochs[0]) if t0 is None else number(t0, "t0")
    wanted = epochs if t_output is None else times(t_output, "t_output")
    if len(epochs) and begin > epochs[-1]:
        raise InputError(
            f"comes after the log's last epoch, {float(epochs[-1])!r} s", field="t0", value=begin
        )
    later = wanted[wanted > begin]
    if len(epochs) and (not len(later) or later[-1] < epochs[-1]) and epochs[-1] > begin:
        later = np.append(later, epochs[-1])
    return np.concatenate([[begin], later])


def covariance_of(sigma0: Sigma0 | None, covariance0: ArrayLike | None) -> FloatArray:
    """Return the covariance of a start (6, 6)."""
    if covariance0 is not None:
        if sigma0 is not None:
            raise InputError("give sigma0 or covariance0, not both", field="covariance0")
        p = array(covariance0, "covariance0", (6, 6))
        if not (np.isfinite(p).all() and np.allclose(p, p.T, rtol=1e-9, atol=0.0)):
            raise InputError("must be finite and symmetric", field="covariance0", value=p)
        return np.ascontiguousarray(0.5 * (p + p.T))
    pair = START_SIGMA if sigma0 is None else sigma0
    if not isinstance(pair, Sequence | np.ndarray) or len(pair) != 2:
        raise InputError("needs (position [m], velocity [m/s])", field="sigma0", value=sigma0)
    sigma = np.concatenate([positive(part, "sigma0") for part in pair])
    assert sigma.max() < LARGEST
    return np.diag(sigma * sigma)


def solution(
    nav: CelestialNavigator, log: CelestialLog, out: dict[str, Any], names: list[str], back: bool
) -> OrbitSolution:
    """Return the core's answer as a solution."""
    seen, used = int(out["stars"].sum()), int(out["used"].sum())
    if seen - used > max(20, 0.5 * seen):
        warn(
            f"{seen - used} of {seen} angles were outside the gate: the start, the noise or the "
            "stars are probably wrong"
        )
    recovered = int(np.isnan(out["effective"]).sum())
    if recovered:
        warn(
            f"no particle explained {recovered} of {len(out['effective'])} measurements: there the "
            "word of the Kalman filter was taken, or none (see recover)"
        )
    state, final, p = out["state"], out["final_state"], out["final_covariance"]
    columns = ("t", "sigma", "measurement_t", "sensor", "row", "nis", "dof", "accepted")
    more = ("innovation", "innovation_sigma", "stars", "used")
    return OrbitSolution(
        **{name: out[name] for name in columns + more},
        r=np.ascontiguousarray(state[:, :3]),
        v=np.ascontiguousarray(state[:, 3:]),
        covariance=out.get("covariance"),
        ess=out["effective"],
        counts={
            "epochs": len(log.times),
            "angles": seen,
            "rejected": seen - used,
            "missing": sum(table.missing for table in log.tables.values()),
            "predicted_only": _predicted_only(log, out),
            "recovered": recovered,
            "outside": int(out["outside"]),
        },
        epoch=log.epoch,
        filter=nav.filter.kind,
        elapsed_s=out["elapsed_s"],
        final={
            "t": out["final_t"],
            "r": final[:3],
            "v": final[3:],
            "sigma": np.sqrt(np.diag(p)),
            "covariance": p,
        },
        smoothed=back,
        log_likelihood=float(out["log_likelihood"]),
        sensor_names=names,
    )


def _predicted_only(log: CelestialLog, out: dict[str, Any]) -> int:
    """Count the epochs of which nothing was used: rejected ones, and those without any angle."""
    used = np.unique(out["measurement_t"][out["accepted"]])
    begin, end = out["t"][0], out["final_t"]
    within = log.times[(log.times >= begin) & (log.times <= end)]
    return len(within) - len(used)
