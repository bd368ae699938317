"""How a campaign is described to the core, and how an executor shares it."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar, Protocol, TypeAlias, TypeVar
from uuid import uuid4

import numpy as np

from celestcore import _core
from celestcore._arguments import Sigma0, count, each_checked, sigma_of
from celestcore._check import FloatArray, number, warn
from celestcore._replay import BIAS_SIGMA
from celestcore._scores import S
from celestcore.errors import InputError
from celestcore.navigator import StarGyroNavigator
from celestcore.simulate import Scenario, StarErrors

Navigators: TypeAlias = "StarGyroNavigator | Mapping[str, StarGyroNavigator]"
Progress: TypeAlias = Callable[[int, int], object]
Each: TypeAlias = "dict[str, tuple[str, bool]]"
"""By the name of a result: the navigator's name, and whether it is smoothed."""


class Named(Protocol):
    """A navigator, as far as its name goes."""

    @property
    def filter(self) -> Any: ...


N = TypeVar("N", bound=Named)

STARTS = ("first_fix", "drawn")
SMOOTHED = "_smoothed"
IN_FLIGHT = 64
"""Tasks that wait in an executor at most: each holds a copy of the scenario."""
CHUNKS = 128
"""Parts that a campaign is cut into for an executor at least, if nothing else is asked for."""
STEPS = 300_000
"""Filter steps in a part at most, if there is more than one trial: some tenths of a second."""
LONGEST = 3 * STEPS
"""Filter steps in a group of trials at most; longer trials go one by one."""


class Executor(Protocol):
    """What `monte_carlo` needs of an executor, as in `concurrent.futures`.

    Examples
    --------
    >>> from concurrent.futures import ThreadPoolExecutor
    >>> from celestcore import monte_carlo, simulate
    >>> truth = simulate.earth_pointing(20.0)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
    >>> with ThreadPoolExecutor(2) as pool:
    ...     monte_carlo(scenario, scenario.navigator(), trials=4, executor=pool)
    MonteCarlo(4 trials of ekf, seed 0)
    """

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        """Return a future of ``fn(*args)``.

        Parameters
        ----------
        fn : callable
            It and its arguments can be pickled.
        *args
            Its arguments.

        Returns
        -------
        future
            With a method ``result()``.

        Examples
        --------
        >>> from concurrent.futures import ThreadPoolExecutor
        >>> with ThreadPoolExecutor(1) as pool:
        ...     pool.submit(max, 1, 2).result()
        2
        """


class Stopped(Exception):  # noqa: N818  (it never reaches a user)
    """What a part of a campaign ends with when the campaign has ended."""


class Stop:
    """Ends the parts of one campaign that run in this process.

    A copy in another process is of the same campaign, but no word of its end reaches it.
    """

    _ended: ClassVar[set[str]] = set()

    def __init__(self, campaign: str | None = None) -> None:
        self._campaign = campaign or uuid4().hex

    def set(self) -> None:
        self._ended.add(self._campaign)

    def __call__(self, done: int, total: int) -> None:
        if self._campaign in self._ended:
            raise Stopped

    def __reduce__(self) -> tuple[type[Stop], tuple[str]]:
        return Stop, (self._campaign,)


@dataclass(frozen=True)
class Job:
    """A campaign without its trials; it can be pickled."""

    flight: Mapping[str, Any]
    estimators: list[dict[str, Any]]
    seed: int
    skip: float
    threads: int
    portable: bool
    stop: Stop = field(default_factory=Stop)

    group: ClassVar[int] = 8
    """Trials that the core runs side by side: parts of whole groups waste none of its lanes."""
    engine: ClassVar[Callable[..., list[dict[str, Any]]]] = staticmethod(_core.monte_carlo)
    """What runs it in the core."""

    def __call__(
        self, first: int, trials: int, progress: Progress | None = None
    ) -> list[dict[str, Any]]:
        return self.engine(
            flight=self.flight,
            estimators=self.estimators,
            seed=self.seed,
            first=first,
            count=trials,
            skip=self.skip,
            threads=self.threads,
            portable=self.portable,
            progress=progress,
        )

    def part(self, trials: int) -> int:
        """Return how many trials go into one task of an executor by default."""
        steps = len(self.flight["t"]) * len(self.estimators) + self.readings()
        part = max(1, min(-(-trials // CHUNKS), STEPS // steps))
        if self.group * steps > LONGEST:
            return part
        return -(-part // self.group) * self.group

    def readings(self) -> int:
        """Return how many readings a trial simulates beside those at each step."""
        return sum(len(camera[0]) for camera in self.flight["cameras"])


def run_part(job: Job, first: int, trials: int) -> list[dict[str, Any]]:
    """Run some of a campaign's trials, in whatever process."""
    job.stop(0, trials)
    aligned = replace(job, flight=_aligned(job.flight), estimators=_aligned(job.estimators))
    try:
        return aligned(first, trials, job.stop)
    except KeyboardInterrupt:
        job.stop.set()  # Ctrl-C reached this worker, which would go on with what it was handed
        raise


def _aligned(value: Any) -> Any:
    """Return the same with arrays that the core takes: out of a message they may lie anywhere."""
    if isinstance(value, np.ndarray):
        return np.require(value, np.float64, ["C_CONTIGUOUS", "ALIGNED"])
    if isinstance(value, Mapping):
        return {name: _aligned(item) for name, item in value.items()}
    if isinstance(value, list | tuple):
        return type(value)(_aligned(item) for item in value)
    return value


def spread(
    executor: Executor, job: Job, trials: tuple[int, int, int], progress: Progress | None
) -> list[list[dict[str, Any]]]:
    """Return the parts of a campaign in order; `trials` is the first, how many, and in a part."""
    first, total, size = trials
    submit = getattr(executor, "submit", None)
    if not callable(submit):
        raise InputError("needs submit(fn, *args), as in concurrent.futures", field="executor")
    sizes = [min(size, total - done) for done in range(0, total, size)]
    waiting: deque[Any] = deque()
    out: list[list[dict[str, Any]]] = []
    done = sent = 0
    try:
        while len(out) < len(sizes):
            while len(waiting) < IN_FLIGHT and len(out) + len(waiting) < len(sizes):
                part = sizes[len(out) + len(waiting)]
                waiting.append(submit(run_part, job, first + sent, part))
                sent += part
            out.append(waiting[0].result())
            waiting.popleft()
            done += sizes[len(out) - 1]
            if progress is not None:
                progress(done, total)
    except BaseException:
        job.stop.set()
        raise
    finally:
        for future in waiting:
            cancel = getattr(future, "cancel", None)
            if callable(cancel):
                cancel()
    return out


def run_all(
    job: Job,
    trials: tuple[int, int, int | None],
    executor: Executor | None,
    progress: Progress | None,
) -> list[list[dict[str, Any]]]:
    """Return the parts of a campaign in order; `trials` is the first, how many, and in a part."""
    if progress is not None and not callable(progress):
        raise InputError("must be callable as progress(done, total)", field="progress")
    first, total, chunk = trials
    size = job.part(total) if chunk is None else count(chunk, "chunk")
    if executor is None:
        return [job(first, total, progress)]
    return spread(executor, job, (first, total, size), progress)


def checked_skip(skip: float, t: FloatArray, both_ends: bool) -> float:
    """Return the time that is left out of the scores, if it leaves something."""
    left_out = number(skip, "skip", at_least=0.0)
    if left_out * (2.0 if both_ends else 1.0) >= float(t[-1] - t[0]):
        raise InputError("leaves nothing to score", field="skip", value=left_out)
    return left_out


def named(navigators: N | Mapping[str, N], kind: type[N]) -> dict[str, N]:
    """Return navigators by name; one alone goes by its filter's."""
    given = each_checked(navigators, "navigators", kind)
    if isinstance(given, kind):
        return {given.filter.kind: given}
    if not given:
        raise InputError("needs one navigator at least", field="navigators")
    return dict(given)


def smoothed_of(navs: Collection[str], smooth: bool | Collection[str]) -> Each:
    """Return what is estimated, in order."""
    wanted: list[str]
    if isinstance(smooth, bool):
        wanted = list(navs) if smooth else []
    else:
        wanted = [smooth] if isinstance(smooth, str) else list(smooth)
    for name in wanted:
        if name not in navs:
            known = ", ".join(navs)
            raise InputError(f"is no navigator; they are {known}", field="smooth", value=name)
    out: Each = {name: (name, False) for name in navs}
    for name in wanted:
        if name + SMOOTHED in navs:
            raise InputError("is the name of a smoothed estimate", field=name + SMOOTHED)
        out[name + SMOOTHED] = (name, True)
    return out


class Start:
    """What each estimator starts from: its initial covariance, and 1-sigma of the bias."""

    def __init__(
        self,
        start: str,
        sigma0: Sigma0 | Mapping[str, Sigma0] | None,
        navs: Mapping[str, StarGyroNavigator],
    ) -> None:
        if start not in STARTS:
            known = " or ".join(STARTS)
            raise InputError(f"must be {known}", field="start", value=start)
        given = sigma0 if isinstance(sigma0, Mapping) else dict.fromkeys(navs, sigma0)
        if set(given) != set(navs):
            raise InputError(
                f"needs one entry for each navigator: {', '.join(navs)}", field="sigma0"
            )
        self._drawn = start == "drawn"
        self._sigma = {name: None if s is None else sigma_of(s) for name, s in given.items()}
        if self._drawn and any(s is None for s in self._sigma.values()):
            raise InputError(
                "is needed with start='drawn': (attitude [rad], bias [rad/s])", field="sigma0"
            )

    def of(self, name: str) -> dict[str, Any]:
        sigma = self._sigma[name]
        bias = [BIAS_SIGMA] * 3 if sigma is None else sigma[3:].tolist()
        drawn: FloatArray | None = None
        if self._drawn and sigma is not None:
            drawn = np.diag(sigma * sigma)
        return {"covariance0": drawn, "bias_sigma": bias}


def described(
    scenario: Scenario, nav: StarGyroNavigator, start: Mapping[str, Any], smooth: bool
) -> dict[str, Any]:
    """Return an estimator as the core takes it."""
    if nav.gyro.sampling != "hold":
        raise InputError(
            "simulated readings hold from their time to the next: it must be 'hold'",
            field="gyro.sampling",
            value=nav.gyro.sampling,
        )
    turn = nav.gyro._turn()
    cameras = []
    for name, flown in scenario.cameras.items():
        camera = nav._camera(name)
        noise = [0.0] * 6  # fixes of a physical camera bring their own
        if isinstance(flown, StarErrors):
            noise = camera.to_body([[1.0, 0.0, 0.0, 0.0]])[1][0].tolist()
        cameras.append((camera.mounting, noise))
    return {
        "setup": nav._setup(nav._max_gap(scenario.truth.t)),
        "gyro_turn": None if turn is None else turn.tolist(),
        "cameras": cameras,
        "smooth": smooth,
        **start,
    }


def warn_of_failures(scores: Mapping[str, S]) -> None:
    """Warn of trials in which a filter broke down."""
    for name, s in scores.items():
        if s.failures:
            trial, reason = next(iter(s.failures.items()))
            share = f"{len(s.failures)} of {len(s)} trials"
            warn(f"{name} broke down in {share}; trial {trial}: {reason}")
