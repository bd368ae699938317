"""`CelestialNavigator`: an orbit from what a satellite sees of stars and the Earth."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._arguments import checked, count
from celestcore._check import number
from celestcore._epoch import epoch_string
from celestcore.celestial import _run
from celestcore.celestial._run import Sigma0
from celestcore.celestial.log import CelestialLog
from celestcore.celestial.measurements import StarHorizon
from celestcore.celestial.refraction import StarRefraction
from celestcore.celestial.solution import OrbitSolution
from celestcore.celestial.stream import CelestialState
from celestcore.errors import InputError
from celestcore.filters import EKF, UKF, UPF, BootstrapPF, IteratedEKF, LiteralUKF, ScoreEKF
from celestcore.orbit.dynamics import OrbitDynamics
from celestcore.orbit.propagate import environment_of, position, velocity
from celestcore.simulate._scenario import whole

if TYPE_CHECKING:
    from celestcore.celestial.montecarlo import MonteCarlo
    from celestcore.celestial.scenario import Scenario

__all__ = ["CelestialNavigator"]

OrbitFilter: TypeAlias = EKF | UKF | IteratedEKF | ScoreEKF | UPF | BootstrapPF
KINDS = (EKF, UKF, IteratedEKF, ScoreEKF, UPF, BootstrapPF)


class CelestialNavigator:
    """Position and velocity of a satellite of the Earth from angles to stars.

    State, in the order of `sigma` and of covariances: position x, y, z [m], velocity x, y, z
    [m/s], GCRS.

    Parameters
    ----------
    filter : EKF, UKF, SRUKF, IteratedEKF, ScoreEKF, UPF or BootstrapPF
        The filter.
    dynamics : OrbitDynamics
        Forces and their uncertainty.
    measurements : StarHorizon, StarRefraction, or a sequence of both
        Noise of the angles, as the filter knows it.
    gate : float, optional
        Probability with which a good angle passes the chi-square gate, for example 0.9999. Each
        angle is held against its own prediction; None: all are used.
    huber : float, optional
        Instead of a gate: angles beyond so many standard deviations count less, in proportion.
        1.345 loses 5 % if all are good (Huber 1964).
    combine : bool
        Whether the angles of an epoch are first combined to the nadir direction that they give
        (nothing is lost, and the errors they share are treated right), or used one by one, as if
        they shared nothing. `ScoreEKF` uses angles that share nothing one by one always.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> import celestcore as cc
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
    >>> nav = CelestialNavigator(cc.UKF(), dynamics, cc.StarHorizon(), gate=0.9999)
    >>> log = cc.CelestialLog(horizon=([0.0, 3.0], [[0.0, 0.0, 1.0]] * 2, [1.571, 1.574]))
    >>> sol = nav.run(log, r0=[7e6, 0, 0], v0=[0, 0, 7.5e3], sigma0=(1e3, 1.0))
    >>> len(sol)
    2
    """

    def __init__(
        self,
        filter: OrbitFilter,  # noqa: A002 - the field's word
        dynamics: OrbitDynamics,
        measurements: StarHorizon | StarRefraction | Sequence[Any],
        *,
        gate: float | None = None,
        huber: float | None = None,
        combine: bool = True,
    ) -> None:
        self.filter: OrbitFilter = checked(filter, "filter", *KINDS)
        if isinstance(filter, LiteralUKF):
            raise InputError("estimates attitudes, not orbits", field="filter", value=filter)
        self.dynamics: OrbitDynamics = checked(dynamics, "dynamics", OrbitDynamics)
        given = measurements if isinstance(measurements, Sequence) else [measurements]
        self.measurements = tuple(
            checked(m, "measurements", StarHorizon, StarRefraction) for m in given
        )
        if not self.measurements:
            raise InputError("needs at least one, such as StarHorizon()", field="measurements")
        if len({type(m) for m in self.measurements}) < len(self.measurements):
            raise InputError("takes one of each kind", field="measurements", value=len(given))
        self.gate = None if gate is None else number(gate, "gate", above=0.0)
        self.huber = None if huber is None else number(huber, "huber", above=0.0)
        if self.gate is not None and self.gate > 1.0:
            raise InputError(
                "is a probability, for example 0.9999; 1 accepts all", field="gate", value=gate
            )
        if self.gate is not None and self.huber is not None:
            raise InputError("give gate or huber, not both", field="huber", value=huber)
        self.combine = bool(combine)
        self._check_outliers()

    def _check_outliers(self) -> None:
        if self.huber is not None and not self._together:
            raise InputError("weighs the angles that are combined", field="huber", value=self.huber)

    def __repr__(self) -> str:
        return (
            f"CelestialNavigator({self.filter!r}, {self.dynamics!r}, {self.measurements!r}, "
            f"gate={self.gate}, huber={self.huber}, combine={self.combine})"
        )

    def run(
        self,
        log: CelestialLog,
        r0: ArrayLike,
        v0: ArrayLike,
        *,
        sigma0: Sigma0 | None = None,
        covariance0: ArrayLike | None = None,
        t0: float | None = None,
        t_output: ArrayLike | None = None,
        every: int = 1,
        covariance: bool = False,
        environment: dict[str, Any] | None = None,
        seed: int = 0,
        trial: int = 0,
        portable: bool = False,
        progress: Callable[[int, int], object] | None = None,
    ) -> OrbitSolution:
        """Estimate the orbit over a log.

        Parameters
        ----------
        log : CelestialLog
            What was measured.
        r0, v0 : array_like (3,)
            Position [m] and velocity [m/s] at the start, GCRS.
        sigma0 : (position, velocity), optional
            1-sigma of the start [m], [m/s], each a number or three; 1 km and 1 m/s.
        covariance0 : array_like (6, 6), optional
            Full covariance of the start instead.
        t0 : float, optional
            Time of the start [s since the log's epoch]; that of the first epoch.
        t_output : array_like (n,), optional
            Times of the output rows beside the start [s], increasing; the epochs of the log. The
            run ends at the last of both.
        every : int
            One output row every so many of these.
        covariance : bool
            Whether to keep full covariances.
        environment : dict, optional
            Tables from `celestcore.frames.environment` to be used again.
        seed, trial : int
            Of a particle filter's random numbers: same numbers, same bits.
        portable : bool
            Compute without the wide instructions of this machine: same bits on every x86-64
            machine, slower.
        progress : callable, optional
            ``progress(done, total)``, called now and then.

        Returns
        -------
        OrbitSolution

        Raises
        ------
        InputError
            Kilometres for metres, a start inside the Earth or after the log, a force that needs
            an epoch which the log does not have.
        NumericalError
            A covariance that is no longer positive definite; names step and time.
        KeyboardInterrupt
            On Ctrl-C, within a fraction of a second.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> log = cc.CelestialLog(horizon=([0.0, 3.0], [[0.0, 0.0, 1.0]] * 2, [1.571, 1.574]))
        >>> nav.run(log, [7e6, 0, 0], [0, 0, 7.5e3]).final["t"]
        3.0
        """
        given: dict[str, Any] = {
            "sigma0": sigma0,
            "covariance0": covariance0,
            "t0": t0,
            "t_output": t_output,
            "every": every,
            "covariance": covariance,
            "environment": environment,
            "seed": seed,
            "trial": trial,
            "portable": portable,
            "progress": progress,
        }
        return self._replay(log, r0, v0, given, back=False)

    def smooth(
        self, log: CelestialLog, r0: ArrayLike, v0: ArrayLike, **options: Any
    ) -> OrbitSolution:
        """Go over a log forward and back: every row knows the measurements before and after it.

        Parameters
        ----------
        log : CelestialLog
            What was measured.
        r0, v0 : array_like (3,)
            Position [m] and velocity [m/s] at the start, GCRS.
        **options
            Those of `run`.

        Returns
        -------
        OrbitSolution
            With ``smoothed=True``; what it says of measurements is the forward pass's.

        Raises
        ------
        InputError, NumericalError, KeyboardInterrupt
            As `run`.

        Notes
        -----
        Rauch, Tung, Striebel 1965; for sigma points Sarkka 2008.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> log = cc.CelestialLog(horizon=([0.0, 3.0], [[0.0, 0.0, 1.0]] * 2, [1.571, 1.574]))
        >>> nav.smooth(log, [7e6, 0, 0], [0, 0, 7.5e3]).smoothed
        True
        """
        unknown = set(options) - set(_run.DEFAULTS)
        if unknown:
            raise InputError(
                f"is not an option; known are {', '.join(_run.DEFAULTS)}", field=min(unknown)
            )
        return self._replay(log, r0, v0, {**_run.DEFAULTS, **options}, back=True)

    def monte_carlo(self, scenario: Scenario, trials: int = 40, **options: Any) -> MonteCarlo:
        """Run many simulated trials of a scenario through this navigator.

        Parameters
        ----------
        scenario : celestcore.celestial.Scenario
            Orbit, cameras and errors.
        trials : int
            How many.
        **options
            Those of `celestcore.celestial.monte_carlo`: `seed`, `smooth`, `skip`, `threads`, ...

        Returns
        -------
        MonteCarlo

        Raises
        ------
        InputError, KeyboardInterrupt
            As `celestcore.celestial.monte_carlo`.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> nav.monte_carlo  # doctest: +ELLIPSIS
        <bound method ...
        """
        from celestcore.celestial.montecarlo import monte_carlo

        return monte_carlo(scenario, self, trials, **options)

    def start(
        self,
        t: float,
        r: ArrayLike,
        v: ArrayLike,
        sigma0: Sigma0 | None = None,
        covariance0: ArrayLike | None = None,
        *,
        epoch: Any = None,
        until: float = 86400.0,
    ) -> CelestialState:
        """Start a filter that is fed epoch by epoch.

        Parameters
        ----------
        t : float
            Time of the start [s since `epoch`].
        r, v : array_like (3,)
            Position [m] and velocity [m/s] then, GCRS.
        sigma0 : (position, velocity), optional
            1-sigma of the start [m], [m/s]; 1 km and 1 m/s.
        covariance0 : array_like (6, 6), optional
            Full covariance of the start instead.
        epoch : str, astropy Time or None
            Where times count from; needed where a force depends on it.
        until : float
            How far beyond the start the tables of such forces reach [s].

        Returns
        -------
        CelestialState

        Raises
        ------
        InputError
            Names the field and the value; also a filter that replays whole logs only.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.UKF(), dynamics, cc.StarHorizon())
        >>> nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], sigma0=(1e3, 1.0)).sigma
        array([1000., 1000., 1000.,    1.,    1.,    1.])
        """
        begin = number(t, "t")
        span = np.array([begin, begin + number(until, "until", above=0.0)])
        tables = environment_of(self.dynamics.force, epoch_string(epoch), span, None)
        start = [*position(r), *velocity(v)]
        return CelestialState(
            self, begin, start, _run.covariance_of(sigma0, covariance0), tables, epoch
        )

    @property
    def _together(self) -> bool:
        """Whether angles are combined; the score filter needs them apart to know their noise."""
        knows = isinstance(self.filter, ScoreEKF) and (
            self.horizon is None or not self.horizon.shared
        )
        return self.combine and not knows

    @property
    def horizon(self) -> StarHorizon | None:
        """The measurement of angles to the nadir, if there is one."""
        return next((m for m in self.measurements if isinstance(m, StarHorizon)), None)

    @property
    def refraction(self) -> StarRefraction | None:
        """The measurement of starlight refraction, if there is one."""
        return next((m for m in self.measurements if isinstance(m, StarRefraction)), None)

    def _described(
        self, tables: dict[str, Any] | None, epoch: Any = None, t: float = 0.0
    ) -> dict[str, Any]:
        """Return filter, dynamics and sensors for the core."""
        outliers = ("keep", 0.0)
        if self.gate is not None:
            outliers = ("gate", self.gate)
        elif self.huber is not None:
            outliers = ("huber", self.huber)
        horizon, refraction = self.horizon, self.refraction
        return {
            **self.filter._setup(),
            **self.dynamics._described(tables),
            "outliers": outliers,
            "horizon": None if horizon is None else horizon._described(self._together),
            "refraction": None if refraction is None else refraction._described(epoch, t),
        }

    def _replay(
        self, log: CelestialLog, r0: ArrayLike, v0: ArrayLike, given: dict[str, Any], *, back: bool
    ) -> OrbitSolution:
        checked(log, "log", CelestialLog)
        progress = given["progress"]
        if progress is not None and not callable(progress):
            raise InputError("must be callable as progress(done, total)", field="progress")
        used = {"horizon": self.horizon, "refraction": self.refraction}
        tables = {name: table for name, table in log.tables.items() if used.get(name) is not None}
        if not tables:
            raise InputError(
                f"has no table for these measurements; it has {', '.join(log.tables)}", field="log"
            )
        stops = _run.stops(log.times, given["t0"], given["t_output"])
        force = self.dynamics.force
        environment = environment_of(force, log.epoch, stops, given["environment"])
        start = [*position(r0), *velocity(v0)]
        p0 = _run.covariance_of(given["sigma0"], given["covariance0"])
        columns = {name: (table.t, table.star, table.angle) for name, table in tables.items()}
        random = (whole(given["seed"], "seed", 64), whole(given["trial"], "trial", 56))
        described = self._described(environment, log.epoch, float(stops[len(stops) // 2]))
        out = _core.celestial_run(
            {**described, "random": random},
            stops,
            columns.get("horizon"),
            columns.get("refraction"),
            (float(stops[0]), start, p0),
            count(given["every"], "every"),
            bool(given["covariance"]),
            back,
            bool(given["portable"]),
            progress,
        )
        return _run.solution(self, log, out, list(tables), back)
