"""Works on gyro and star camera: propagation and the filters, one log or a batch of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from celestcore import _core
from celestcore.bench import _inputs, _outcome
from celestcore.bench._inputs import LANES, AttitudeInput
from celestcore.bench._outcome import Outcome
from celestcore.bench._work import Entry, Target, Timed, Work
from celestcore.filters import EKF, SRUKF, UKF
from celestcore.navigator import StarGyroNavigator
from celestcore.sensors import Gyro, StarCamera
from celestcore.solution import Solution

PEERS = "celestcore.bench.peers"
STEPS = 4000
"""Short enough for the processor's own memory, as in the yardsticks."""
QUICK = 1000
PARTS = 20
"""Propagations of which the shortest counts as one run."""


def navigator(kind: EKF | UKF, given: AttitudeInput) -> StarGyroNavigator:
    """Return celestcore's navigator for a log."""
    return StarGyroNavigator(
        kind, Gyro(arw=given.arw, rrw=given.rrw), StarCamera(sigma=given.sigma)
    )


def _end(solution: Solution) -> Outcome:
    final = solution.final
    return {"q": np.asarray(final["q"]), "sigma": np.asarray(final["sigma"])}


def _propagate(given: AttitudeInput) -> Timed:
    ns, q = _core._bench_propagate([1.0, 0.0, 0.0, 0.0], given.gyro[:-1], given.dt, PARTS)
    return Timed(ns, {"q": q[-1]})


def _filter(kind: EKF | UKF) -> Callable[[AttitudeInput], Timed]:
    """Return a run that writes the last row only, as the core times it."""

    def run(given: AttitudeInput) -> Timed:
        solution = navigator(kind, given).run(given.log, every=given.steps)
        return Timed(1e9 * solution.elapsed_s / given.steps, _end(solution))

    return run


def _batch(kind: EKF | UKF) -> Callable[[Sequence[AttitudeInput]], Timed]:
    """Return a run of all logs at once, per filter and step."""

    def run(given: Sequence[AttitudeInput]) -> Timed:
        nav: Any = navigator(kind, given[0])
        logs, steps = [one.log for one in given], given[0].steps
        # like the yardstick, it keeps nothing of the measurements: in lanes a record of each fix
        # costs as much as the filter
        options: dict[str, Any] = {"every": steps, "threads": 1, "innovations": "none"}
        found: list[Solution] = nav.run_many(logs, **options)
        # all solutions tell the time of the whole batch; different times are those of each log
        told = [one.elapsed_s for one in found]
        taken = told[0] if len(set(told)) == 1 else sum(told)
        ends = [_end(one) for one in found]
        outcome = {name: np.stack([end[name] for end in ends]) for name in ends[0]}
        return Timed(1e9 * taken / (len(logs) * steps), outcome)

    return run


def _no_batch() -> str | None:
    if hasattr(StarGyroNavigator, "run_many"):
        return None
    return "this celestcore has no StarGyroNavigator.run_many"


def works() -> list[Work]:
    """Return the works on attitudes."""
    one: dict[str, Any] = {
        "item": "sample", "size": STEPS, "quick": QUICK, "make": _inputs.attitude
    }  # fmt: skip
    many = {**one, "item": "filter step", "make": _inputs.batch, "count": LANES}
    many["missing"] = _no_batch
    near = _outcome.attitude(0.5)
    return [
        Work(
            name="propagation",
            title="quaternion propagation, history kept",
            run=_propagate,
            agree=_outcome.attitude(1e-3),
            task="a_prop",
            target=Target(1.3),
            kernel="propagation",
            peers={
                "numba": Entry(f"{PEERS}.numba_attitude:propagation", STEPS),
                "numpy-quaternion": Entry(f"{PEERS}.numpy_quaternion:propagation", STEPS),
                "scipy": Entry(f"{PEERS}.scipy_attitude:propagation", QUICK),
                "jax": Entry(f"{PEERS}.jax_attitude:propagation", STEPS),
            },
            **one,
        ),
        Work(
            name="mekf",
            title="MEKF, star fix every 2nd sample",
            run=_filter(EKF()),
            agree=near,
            task="b_mekf",
            target=Target(1.3),
            kernel="ekf",
            peers={
                "numba": Entry(f"{PEERS}.numba_attitude:mekf", STEPS),
                "filterpy": Entry(f"{PEERS}.filterpy_attitude:mekf", QUICK),
                "scipy": Entry(f"{PEERS}.scipy_attitude:mekf", QUICK),
                "jax": Entry(f"{PEERS}.jax_attitude:mekf", STEPS),
            },
            **one,
        ),
        Work(
            name="ukf",
            title="UKF, 6 states, 13 sigma points, RK4 each",
            run=_filter(UKF(integrator="rk4")),
            agree=near,
            task="b_ukf",
            target=Target(1.3),
            kernel="ukf",
            peers={
                "numba": Entry(f"{PEERS}.numba_attitude:ukf", STEPS),
                "filterpy": Entry(f"{PEERS}.filterpy_attitude:ukf", 200),
                "jax": Entry(f"{PEERS}.jax_attitude:ukf", STEPS),
            },
            **one,
        ),
        Work(
            name="srukf",
            title="square-root UKF, 13 sigma points, RK4 each",
            run=_filter(SRUKF(integrator="rk4")),
            agree=near,
            target=Target(2.0, "ukf"),
            kernel="srukf",
            **one,
        ),
        Work(
            name="mekf_batch",
            title=f"MEKF, {LANES} filters in lanes",
            run=_batch(EKF()),
            agree=near,
            task="b_mekf_batch",
            target=Target(1.5),
            kernel="ekf_batch",
            peers={"jax": Entry(f"{PEERS}.jax_attitude:mekf_batch", STEPS)},
            **many,
        ),
        Work(
            name="ukf_batch",
            title=f"UKF, {LANES} filters in lanes",
            run=_batch(UKF(integrator="rk4")),
            agree=near,
            task="b_ukf_batch",
            target=Target(1.5),
            kernel="ukf_batch",
            peers={"jax": Entry(f"{PEERS}.jax_attitude:ukf_batch", STEPS)},
            **many,
        ),
    ]
