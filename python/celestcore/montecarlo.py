"""Monte Carlo: many seeded trials of a scenario, each run through one or several estimators."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from celestcore._arguments import Sigma0, checked, count, processors
from celestcore._campaign import (
    Executor,
    Job,
    Navigators,
    Progress,
    Start,
    checked_skip,
    described,
    named,
    run_all,
    smoothed_of,
    warn_of_failures,
)
from celestcore._scores import COLUMNS, MonteCarlo, Pooled, Scores, gather
from celestcore.navigator import StarGyroNavigator
from celestcore.simulate import Scenario
from celestcore.simulate._scenario import whole

__all__ = ["Executor", "MonteCarlo", "Pooled", "Scores", "monte_carlo"]


def monte_carlo(
    scenario: Scenario,
    navigators: Navigators,
    trials: int = 100,
    seed: int = 0,
    *,
    first: int = 0,
    smooth: bool | Collection[str] = False,
    skip: float = 0.0,
    start: str = "first_fix",
    sigma0: Sigma0 | Mapping[str, Sigma0] | None = None,
    threads: int | None = None,
    executor: Executor | None = None,
    chunk: int | None = None,
    portable: bool = False,
    progress: Progress | None = None,
) -> MonteCarlo:
    """Run many trials of a scenario through one or several estimators.

    Each trial is simulated once, and every estimator runs on it. A trial's result is the same to
    the last bit for any number of threads, in any part of a campaign, and through any executor
    whose workers have the same kind of processor.

    Parameters
    ----------
    scenario : Scenario
        What is flown, with which sensors.
    navigators : StarGyroNavigator or dict of str to StarGyroNavigator
        The estimators. One alone goes by its filter's name, for example ``"ekf"``.
    trials : int
        How many.
    seed : int
        Chooses the random numbers of all trials, from 0 to 2**64 - 1.
    first : int
        Number of the first trial; a campaign may be continued with the next ones.
    smooth : bool or collection of str
        Which estimators to smooth as well: all, none, or those of the names. The smoothed ones get
        a name that ends with ``"_smoothed"``.
    skip : float
        Time from the start that is not scored; of a smoother also at the end [s].
    start : {"first_fix", "drawn"}
        Each trial starts from its first star fixes, as `StarGyroNavigator.run` does, or at the
        first sample from the truth with an error drawn from `sigma0`.
    sigma0 : (attitude, bias) or dict of str to (attitude, bias), optional
        1-sigma of the start [rad], [rad/s], each a number or three; of ``"first_fix"`` only the
        bias part is used (by default 1e-3 rad/s). A dict gives each estimator its own.
    threads : int, optional
        By default all processors; with an executor one for each task.
    executor : Executor, optional
        Anything with ``submit(fn, *args)`` that returns futures: a pool of `concurrent.futures`,
        or a Dask cluster's ``client.get_executor()``. Trials go to it in chunks.
    chunk : int, optional
        Trials in one task of the executor; by default such that there are 128 tasks, or more where
        one would take longer than some tenths of a second, in whole groups of eight unless trials
        are long: EKF and UKF run eight side by side.
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
        On Ctrl-C, within a fraction of a second; see Notes for what an executor may go on with.

    Warns
    -----
    CelestcoreWarning
        Where a filter broke down in some trials; they count as NaN.

    Notes
    -----
    On Ctrl-C, or any other error, the call ends at once and cancels the tasks that have not begun.
    Tasks that run in threads of this process stop within a fraction of a second. Those that run, or
    are already handed to a worker, in other processes cannot be reached and go on to their end: of
    a `ProcessPoolExecutor` up to twice as many as it has workers and one more, of a Dask cluster
    those on its workers' threads. Leaving the pool's ``with`` block waits for them; small chunks
    make that short. Ctrl-C in a terminal goes to the processes of a local pool as well and stops
    theirs; such a pool may be broken afterwards.

    Examples
    --------
    >>> import celestcore as cc
    >>> from celestcore import simulate
    >>> gyro = simulate.GyroErrors(arw=1e-6, rrw=1e-9, bias_sigma=1e-5)
    >>> star = simulate.StarErrors(5 * cc.ARCSEC, every=2)
    >>> scenario = simulate.Scenario(simulate.earth_pointing(120.0), gyro, star)
    >>> navs = {"ekf": scenario.navigator(cc.EKF()), "ukf": scenario.navigator(cc.UKF())}
    >>> result = monte_carlo(scenario, navs, trials=20, seed=1, skip=60.0)
    >>> result
    MonteCarlo(20 trials of ekf, ukf, seed 1)
    >>> 2.5 < result["ukf"].pooled().nees_attitude < 3.5
    True
    """
    checked(scenario, "scenario", Scenario)
    navs = named(navigators, StarGyroNavigator)
    each = smoothed_of(navs, smooth)
    begin = Start(start, sigma0, navs)
    job = Job(
        flight=scenario._described(),
        estimators=[described(scenario, navs[n], begin.of(n), s) for n, s in each.values()],
        seed=whole(seed, "seed", 64),
        skip=checked_skip(skip, scenario.truth.t, any(s for _, s in each.values())),
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
