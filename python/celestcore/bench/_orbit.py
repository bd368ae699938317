"""Works on orbits: filters and particles on star angles, integration, gravity."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from celestcore import _core, frames, orbit
from celestcore._check import FloatArray
from celestcore.bench import _inputs, _outcome
from celestcore.bench._clock import clocked
from celestcore.bench._inputs import OrbitInput
from celestcore.bench._work import Entry, Target, Timed, Work
from celestcore.celestial import CelestialNavigator, StarHorizon
from celestcore.errors import CelestcoreWarning, MissingDependencyError
from celestcore.filters import UKF, UPF, BootstrapPF

PEERS = "celestcore.bench.peers"
STEP = 3.0
"""Integration step [s]."""
EPOCHS = 10
"""Epochs of the bootstrap filter."""
DEGREE = 21
EPOCH = "2020-03-20T00:00:00"


def navigator(kind: UKF | UPF | BootstrapPF, given: OrbitInput) -> CelestialNavigator:
    """Return celestcore's navigator for a log."""
    dynamics = orbit.OrbitDynamics(orbit.ForceModel.j2(), given.accel_psd)
    horizon = StarHorizon(given.sigma, 0.0, correlated=False)
    return CelestialNavigator(kind, dynamics, horizon)


def _run(kind: UKF | UPF | BootstrapPF, given: OrbitInput, items: int) -> Timed:
    """Run over a log, the last row written only, as the core times it."""
    options: dict[str, Any] = {"t0": 0.0, "sigma0": given.sigma0, "every": given.steps}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CelestcoreWarning)  # particles may degenerate
        nav, log = navigator(kind, given), given.log
        taken, found = clocked(lambda: nav.run(log, given.r0, given.v0, **options))
    outcome = {"r": np.asarray(found.final["r"]), "sigma": np.asarray(found.final["sigma"])}
    # a run that is longer than the turn that a busy machine gives it
    return Timed(1e9 * min(taken, found.elapsed_s) / items, outcome)


def _filter(kind: UKF | UPF) -> Callable[[OrbitInput], Timed]:
    return lambda given: _run(kind, given, given.steps)


@dataclass(frozen=True, eq=False)
class Cloud:
    """A log for a bootstrap filter and its number of particles."""

    log: OrbitInput
    particles: int


def _cloud(particles: int) -> Cloud:
    return Cloud(_inputs.sky(EPOCHS, 1e-3, 500.0), particles)


def _bootstrap(given: Cloud) -> Timed:
    kind = BootstrapPF(particles=given.particles, threshold=1.0, kernel=False)
    made = _run(kind, given.log, given.particles * given.log.steps)
    return Timed(made.ns, {"r": made.outcome["r"]})


def _steps(count: int) -> FloatArray:
    return np.asarray(STEP * np.arange(count + 1), dtype=np.float64)


def _integrate(t: FloatArray) -> Timed:
    start, force = _inputs.START, orbit.ForceModel.j2()
    taken, path = clocked(
        lambda: orbit.propagate(force, None, start[:3], start[3:], t, method="rk4", step=STEP)
    )
    return Timed(1e9 * taken / (len(t) - 1), {"r": path.r[-1]})


@dataclass(frozen=True, eq=False)
class GravityInput:
    """Times, states and the rotation to the Earth's frame at each."""

    t: FloatArray
    state: FloatArray
    to_earth: FloatArray
    tables: dict[str, Any]
    force: orbit.ForceModel


@lru_cache(maxsize=2)
def _gravity_input(count: int) -> GravityInput:
    t = _steps(count - 1)
    force, start = orbit.ForceModel(gravity=DEGREE), _inputs.START
    path = orbit.propagate(orbit.ForceModel.j2(), None, start[:3], start[3:], t, method="rk4")
    tables: dict[str, Any] = frames.environment(EPOCH, (0.0, float(t[-1])))
    return GravityInput(t, path.state, _core.orbit_moments(tables, t)[0], tables, force)


def _gravity(given: GravityInput) -> Timed:
    described = given.force._described()
    ns, a = _core._bench_acceleration(described, given.tables, given.t, given.state, 5)
    return Timed(ns, {"a": a})


def _no_tables() -> str | None:
    try:
        frames.environment(EPOCH, (0.0, 60.0))
    except MissingDependencyError as error:
        return str(error)
    return None


def works() -> list[Work]:
    """Return the works on orbits."""
    return [
        Work(
            name="orbit_ukf",
            title="orbit UKF: J2 RK4, 3 star angles",
            item="step",
            size=2000,
            quick=200,
            make=_inputs.sky,
            run=_filter(UKF()),
            agree=_outcome.position(20.0),
            task="c_orbit_ukf",
            target=Target(1.3),
            kernel="orbit_ukf",
            peers={
                "numba": Entry(f"{PEERS}.numba_orbit:ukf", 2000),
                "filterpy": Entry(f"{PEERS}.filterpy_orbit:ukf", 200),
                "jax": Entry(f"{PEERS}.jax_orbit:ukf", 2000),
            },
        ),
        Work(
            name="upf20",
            title="unscented particle filter, a UKF for each of 20 particles",
            item="step",
            size=60,
            quick=20,
            make=_inputs.sky,
            run=_filter(UPF(particles=20, form="literal")),
            task="c_upf20",
            target=Target(1.2),
            kernel="upf20",
        ),
        Work(
            name="bootstrap",
            title="bootstrap filter: J2 RK4, 3 star angles, resampling",
            item="particle step",
            size=100_000,
            quick=10_000,
            make=_cloud,
            run=_bootstrap,
            agree=_outcome.position(50.0),
            task="d_sir1e5",
            target=Target(1.3),
            kernel="bootstrap",
            count=EPOCHS,
            peers={
                "numpy": Entry(f"{PEERS}.numpy_orbit:bootstrap", 100_000),
                "numba": Entry(f"{PEERS}.numba_orbit:bootstrap", 100_000),
                "particles": Entry(f"{PEERS}.particles_orbit:bootstrap", 100_000),
            },
        ),
        Work(
            name="rk4_j2",
            title="RK4 step with J2, history kept, from Python",
            item="step",
            size=12_000,
            quick=2000,
            make=_steps,
            run=_integrate,
            agree=_outcome.position(10.0),
            kernel="rk4_j2",
            peers={
                "numba": Entry(f"{PEERS}.numba_orbit:integrate", 12_000),
                "numpy": Entry(f"{PEERS}.numpy_orbit:integrate", 2000),
                "brahe": Entry(f"{PEERS}.brahe_orbit:integrate", 2000),
            },
        ),
        Work(
            name="gravity21",
            title="gravity 21x21, turned to the Earth and back",
            item="acceleration",
            size=2000,
            quick=200,
            make=_gravity_input,
            run=_gravity,
            agree=_outcome.acceleration(1e-6),
            target=Target(1100.0, "ns"),
            kernel="gravity21",
            missing=_no_tables,
            peers={
                "satkit": Entry(f"{PEERS}.satkit_orbit:gravity", 2000),
                "brahe": Entry(f"{PEERS}.brahe_orbit:gravity", 2000),
            },
        ),
    ]
