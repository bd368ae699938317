"""Monte Carlo: many seeded trials of a flight under the stars, through several navigators."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

from celestcore import _core
from celestcore._arguments import checked, count, processors
from celestcore._campaign import (
    Executor,
    Job,
    Progress,
    checked_skip,
    named,
    run_all,
    smoothed_of,
    warn_of_failures,
)
from celestcore._scores import gather
from celestcore.celestial._scores import COLUMNS, MonteCarlo, Pooled, Scores
from celestcore.celestial.navigator import CelestialNavigator
from celestcore.celestial.scenario import Scenario
from celestcore.errors import InputError
from celestcore.orbit.propagate import environment_of
from celestcore.simulate._scenario import whole

__all__ = ["MonteCarlo", "Pooled", "Scores", "monte_carlo"]

Navigators: TypeAlias = "CelestialNavigator | Mapping[str, CelestialNavigator]"


@dataclass(frozen=True)
class _Job(Job):
    """A campaign without its trials; it can be pickled."""

    group = 1
    engine = staticmethod(_core.celestial_monte_carlo)

    def readings(self) -> int:
        return len(self.flight["star_t"])


def monte_carlo(
    scenario: Scenario,
    navigators: Navigators,
    trials: int = 40,
    seed: int = 0,
    *,
    first: int = 0,
    smooth: bool | Collection[str] = False,
    skip: float = 0.0,
    threads: int | None = None,
    executor: Executor | None = None,
    chunk: int | None = None,
    portable: bool = False,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Run many trials of a scenario through one or several navigators.

    Each trial is simulated once, and every navigator runs on it, from the same start: the truth at
    the first epoch with an error drawn from the scenario's `start_sigma`, and the covariance that
    goes with it. A trial's result is the same to the last bit for any number of threads, in any
    part of a campaign, and through any executor whose workers have the same kind of processor.

    Parameters
    ----------
    scenario : Scenario
        What is flown, seen and measured.
    navigators : CelestialNavigator or dict of str to CelestialNavigator
        The estimators. One alone goes by its filter's name, for example ``"ekf"``.
    trials : int
        How many.
    seed : int
        Chooses the random numbers of all trials, from 0 to 2**64 - 1.
    first : int
        Number of the first trial; a campaign may be continued with the next ones.
    smooth : bool or collection of str
        Which navigators to smooth as well: all, none, or those of the names. The smoothed ones get
        a name that ends with ``"_smoothed"``.
    skip : float
        Time from the start that is not scored, also of a smoother [s].
    threads : int, optional
        By default all processors; with an executor one for each task.
    executor : Executor, optional
        Anything with ``submit(fn, *args)`` that returns futures: a pool of `concurrent.futures`,
        or a Dask cluster's ``client.get_executor()``. Trials go to it in chunks.
    chunk : int, optional
        Trials in one task of the executor; by default such that there are 128 tasks, or more where
        one would take longer than some tenths of a second.
    portable : bool
        Compute without the wide instructions of this machine: same bits on every x86-64 machine.
    progress : callable, optional
        ``progress(done, total)`` [trials], called now and then.

    Returns
    -------
    MonteCarlo

    Raises
    ------
    InputError
        Names the field and the value.
    KeyboardInterrupt
        On Ctrl-C, within a fraction of a second; see `celestcore.monte_carlo` for what an executor
        may go on with.

    Warns
    -----
    CelestcoreWarning
        Where a filter broke down in some trials; they count as NaN.

    Examples
    --------
    >>> import celestcore as cc
    >>> import numpy as np
    >>> t = np.arange(0.0, 1800.0, 30.0)
    >>> orbit = cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000))
    >>> scenario = cc.celestial.Scenario(orbit, sky, cc.StarHorizon(), period=30.0)
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=1e-9)
    >>> navs = {f.kind: cc.CelestialNavigator(f, dynamics, cc.StarHorizon())
    ...         for f in (cc.EKF(), cc.UKF())}
    >>> result = monte_carlo(scenario, navs, trials=10, seed=1, skip=600.0)
    >>> result
    MonteCarlo(10 trials of ekf, ukf, seed 1)
    >>> 3.0 < result["ukf"].pooled().nees < 10.0
    True
    """
    checked(scenario, "scenario", Scenario)
    navs = named(navigators, CelestialNavigator)
    each = smoothed_of(navs, smooth)
    setups = _setups(scenario, navs)
    job = _Job(
        flight=scenario._described,
        estimators=[{"setup": setups[name], "smooth": back} for name, back in each.values()],
        seed=whole(seed, "seed", 64),
        skip=checked_skip(skip, scenario.truth.t, both_ends=False),
        threads=processors(threads, alone=executor is None),
        portable=bool(portable),
    )
    begins, total = whole(first, "first", 56), count(trials, "trials")
    parts = run_all(job, (begins, total, chunk), executor, progress)
    scores = {
        name: gather(Scores, COLUMNS, [p[i] for p in parts], begins) for i, name in enumerate(each)
    }
    warn_of_failures(scores)
    return MonteCarlo(scores, seed=job.seed, first=begins, trials=total, skip=job.skip)


def _setups(scenario: Scenario, navs: Mapping[str, CelestialNavigator]) -> dict[str, Any]:
    """Return each navigator as the core takes it; they share the tables of the Earth's rotation."""
    epoch, t = scenario.orbit.epoch, scenario.truth.t
    tables: dict[str, Any] | None = None
    out = {}
    for name, nav in navs.items():
        if nav.refraction is not None:
            raise InputError(
                "measures starlight refraction, which a Scenario does not simulate; run it trial "
                "by trial on celestial.refracted_stars(...).measured(seed, trial)",
                field=name,
            )
        own = environment_of(nav.dynamics.force, epoch, t, tables)
        tables = own if tables is None else tables
        out[name] = nav._described(own, epoch, float(t[len(t) // 2]))
    return out
