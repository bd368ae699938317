"""`GnssStarNavigator`: orbit and attitude from a GNSS receiver and a star sensor."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._arguments import checked, count, each_checked
from celestcore._check import number
from celestcore.errors import InputError
from celestcore.filters import EKF, UKF
from celestcore.gnss import _run
from celestcore.gnss.antennas import Antennas
from celestcore.gnss.sensors import GnssReceiver, KinematicAttitude, LowFrequencyError
from celestcore.gnss.solution import GnssStarSolution
from celestcore.log import SensorLog
from celestcore.orbit.dynamics import OrbitDynamics
from celestcore.orbit.force import ForceModel
from celestcore.sensors import Gyro, StarCamera
from celestcore.units import ARCSEC

if TYPE_CHECKING:
    from celestcore.gnss.montecarlo import GnssStarMonteCarlo
    from celestcore.gnss.scenario import GnssStarScenario
    from celestcore.gnss.stream import GnssStarState

__all__ = ["GnssStarNavigator"]

OrbitFilter: TypeAlias = EKF | UKF
ACCEL_PSD = 1e-8
"""Density of unmodelled acceleration [m^2/s^3] that goes with gravity of degree 20 in low orbit."""


class GnssStarNavigator:
    """Position, velocity and attitude of an Earth satellite without an inertial unit.

    Two filters share the work. The orbit filter knows position and velocity (GCRS), and the
    receiver's slow error if `gnss` has one; the attitude filter (a multiplicative EKF) knows either
    attitude, rate and acceleration about the orbital frame, or, with a gyro, attitude and the
    gyro's bias, and the star sensor's slow error if `lfe` is given.

    Parameters
    ----------
    filter : EKF or UKF
        The orbit filter.
    dynamics : OrbitDynamics or ForceModel
        Forces and their uncertainty; of a force model alone the uncertainty is 1e-8 m^2/s^3, which
        goes with gravity of degree 20.
    gnss : GnssReceiver
        Noise, lever arm and time offset of the receiver.
    star : StarCamera, or dict of str to StarCamera
        Noise and mounting of the star sensors by the names of their tables.
    attitude : KinematicAttitude
        How the body moves where there is no gyro.
    gyro : Gyro, optional
        With it the gyro's table drives the attitude.
    lfe : LowFrequencyError, optional
        The star sensor's slow error, to be estimated; goes with one star table.
    antennas : Antennas, optional
        Baselines of the GNSS antennas: with it the log's ``baselines`` add to the attitude.
    lever_arm : array_like (3,), optional
        Short for that of `gnss`: antenna from the centre of mass, body frame [m].
    star_time_offset : float
        What the star sensors' time tags are ahead of the log's time [s]: it is subtracted.
    gate : float
        Probability with which a good measurement passes the chi-square gate; 1 accepts all.
    max_rejected : int, optional
        So many positions, or attitude fixes, refused running end a filter's belief: it starts
        again from the fixes there, and says so. None: never.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Star fixes are attitudes with respect to the GCRS: the sensor has corrected its stars for
    proper motion and aberration (annual and of the orbit). Filters: Lefferts, Markley and Shuster
    1982; smoother: Rauch, Tung and Striebel 1965.

    Examples
    --------
    >>> import celestcore as cc
    >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
    >>> nav = GnssStarNavigator(dynamics=cc.orbit.ForceModel(gravity=20),
    ...                         star=cc.StarCamera(20 * cc.ARCSEC))
    >>> sol = nav.run(trial.log)
    >>> sol
    GnssStarSolution(31 rows of orbit and attitude, ekf)
    """

    def __init__(
        self,
        filter: OrbitFilter | None = None,  # noqa: A002 - the field's word
        dynamics: OrbitDynamics | ForceModel | None = None,
        *,
        gnss: GnssReceiver | None = None,
        star: StarCamera | Mapping[str, StarCamera] | None = None,
        attitude: KinematicAttitude | None = None,
        gyro: Gyro | None = None,
        lfe: LowFrequencyError | None = None,
        antennas: Antennas | None = None,
        lever_arm: ArrayLike | None = None,
        star_time_offset: float = 0.0,
        gate: float = 0.9999,
        max_rejected: int | None = 10,
    ) -> None:
        self.filter: OrbitFilter = checked(EKF() if filter is None else filter, "filter", EKF, UKF)
        if self.filter.kind not in ("ekf", "ukf"):
            raise InputError(
                "does not go here: fixes are nearly linear in the orbit, EKF() or UKF() will do",
                field="filter",
                value=self.filter.kind,
            )
        given = ForceModel(gravity=20) if dynamics is None else dynamics
        if isinstance(given, ForceModel):
            given = OrbitDynamics(given, ACCEL_PSD)
        self.dynamics: OrbitDynamics = checked(given, "dynamics", OrbitDynamics, ForceModel)
        if self.dynamics.integrator != "rk4":
            raise InputError(
                "goes with celestial navigation; here it is 'rk4'",
                field="dynamics.integrator",
                value=self.dynamics.integrator,
            )
        self.gnss = checked(GnssReceiver() if gnss is None else gnss, "gnss", GnssReceiver)
        if lever_arm is not None:
            self.gnss = _run.replaced(self.gnss, lever_arm=lever_arm)
        default = StarCamera(20.0 * ARCSEC)
        self.star = each_checked(default if star is None else star, "star", StarCamera)
        kinematic = KinematicAttitude() if attitude is None else attitude
        self.attitude = checked(kinematic, "attitude", KinematicAttitude)
        self.gyro = None if gyro is None else checked(gyro, "gyro", Gyro)
        self.lfe = None if lfe is None else checked(lfe, "lfe", LowFrequencyError)
        self.antennas = None if antennas is None else checked(antennas, "antennas", Antennas)
        self.star_time_offset = number(star_time_offset, "star_time_offset")
        self.gate = number(gate, "gate", above=0.0)
        if self.gate > 1.0:
            raise InputError(
                "is a probability, for example 0.9999; 1 accepts all", field="gate", value=gate
            )
        self.max_rejected = None if max_rejected is None else count(max_rejected, "max_rejected")

    def __repr__(self) -> str:
        parts = [
            repr(self.filter),
            repr(self.dynamics),
            f"gnss={self.gnss!r}",
            f"star={self.star!r}",
        ]
        for name in ("gyro", "lfe", "antennas"):
            if getattr(self, name) is not None:
                parts.append(f"{name}={getattr(self, name)!r}")
        return f"GnssStarNavigator({', '.join(parts)}, gate={self.gate})"

    def run(
        self,
        log: SensorLog,
        *,
        r0: ArrayLike | None = None,
        v0: ArrayLike | None = None,
        sigma0: _run.Sigma0 | None = None,
        t_output: ArrayLike | None = None,
        covariance: bool = False,
        earth_rotation: ArrayLike | Callable[[Any], ArrayLike] | None = None,
        environment: dict[str, Any] | None = None,
        portable: bool = False,
        progress: Callable[[int, int], object] | None = None,
    ) -> GnssStarSolution:
        """Estimate orbit and attitude over a log.

        Parameters
        ----------
        log : SensorLog
            With an epoch and a ``gnss`` table; star tables, ``gyro`` and ``baselines`` as far as
            there are. Every sensor has its own times.
        r0, v0 : array_like (3,), optional
            Position [m] and velocity [m/s] at the first time, GCRS; found in the first fixes, of
            which some may be wrong, unless given.
        sigma0 : (position, velocity), optional
            1-sigma of r0 [m] and v0 [m/s].
        t_output : array_like (n,), optional
            Times of the output [s], increasing, within the log; by default all times of the GNSS
            fixes, the star fixes and the baselines.
        covariance : bool
            Whether to keep full covariances.
        earth_rotation : array_like (n, 3, 3) or callable, optional
            Matrices from the GCRS to the Earth-fixed frame at the GNSS fixes, or a function of
            times that gives them; by default the IERS' as `celestcore.frames.gcrs_to_itrs` reads
            them.
        environment : dict, optional
            Tables from `celestcore.frames.environment` for the forces, to be used again.
        portable : bool
            Compute without the wide instructions of this machine: same bits on every x86-64
            machine, slower.
        progress : callable, optional
            ``progress(done, total)``, called now and then.

        Returns
        -------
        GnssStarSolution

        Raises
        ------
        InputError
            A log without epoch or GNSS fixes, fixes that do not agree, times outside the log.
        NumericalError
            A covariance that is no longer positive definite; names step and time.
        KeyboardInterrupt
            On Ctrl-C, within a fraction of a second.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> sol = GnssStarNavigator().run(trial.log, t_output=[100.0, 250.0])
        >>> sol.t
        array([100., 250.])
        """
        given = {
            "r0": r0,
            "v0": v0,
            "sigma0": sigma0,
            "t_output": t_output,
            "covariance": covariance,
            "earth_rotation": earth_rotation,
            "environment": environment,
            "portable": portable,
            "progress": progress,
        }
        return _run.replay(self, log, given, back=False)

    def smooth(self, log: SensorLog, **options: Any) -> GnssStarSolution:
        """Go over a log forward and back: every row knows the measurements before and after it.

        Parameters
        ----------
        log : SensorLog
            As `run`.
        **options
            Those of `run`.

        Returns
        -------
        GnssStarSolution
            With ``smoothed=True``; what it says of measurements is the forward pass's.

        Raises
        ------
        InputError, NumericalError, KeyboardInterrupt
            As `run`.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=300.0).trial(seed=1, trial=0)
        >>> GnssStarNavigator().smooth(trial.log).smoothed
        True
        """
        unknown = set(options) - set(_run.DEFAULTS)
        if unknown:
            raise InputError(
                f"is not an option; known are {', '.join(_run.DEFAULTS)}", field=min(unknown)
            )
        return _run.replay(self, log, {**_run.DEFAULTS, **options}, back=True)

    def start(
        self,
        t: float,
        r: ArrayLike,
        v: ArrayLike,
        q: ArrayLike | None = None,
        sigma0: _run.Sigma0 | None = None,
        *,
        epoch: Any,
        sigma_q: float = 0.1,
        until: float = 86400.0,
        environment: dict[str, Any] | None = None,
    ) -> GnssStarState:
        """Start filters that are fed one measurement at a time.

        Parameters
        ----------
        t : float
            Time of the start [s since `epoch`].
        r, v : array_like (3,)
            Position [m] and velocity [m/s] then, GCRS.
        q : array_like (4,), optional
            Attitude ``q_ib``; taken from the first star fix unless given.
        sigma0 : (position, velocity), optional
            1-sigma of r [m] and v [m/s]; 1 km and 10 m/s.
        epoch : str or astropy Time
            Where times count from.
        sigma_q : float
            1-sigma of the attitude about each axis [rad].
        until : float
            How far beyond the start the tables of the forces reach [s].
        environment : dict, optional
            Tables to be used again.

        Returns
        -------
        GnssStarState
            With ``predict(t)``, ``update_gnss(t, r_e, v_e)`` and ``update_star(t, q_ib)``.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> trial = cc.gnss.GnssStarScenario(duration=60.0).trial(seed=1, trial=0)
        >>> state = GnssStarNavigator().start(0.0, trial.r_i[0], trial.v_i[0],
        ...                                   epoch=trial.log.epoch, until=600.0)
        >>> gnss = trial.log.gnss
        >>> state.update_gnss(gnss.t[1], gnss.r[1], gnss.v[1]).accepted
        True
        """
        from celestcore.gnss.stream import begin

        return begin(self, t, (r, v, q), (sigma0, sigma_q), epoch, until, environment)

    def monte_carlo(
        self, scenario: GnssStarScenario, trials: int = 40, **options: Any
    ) -> GnssStarMonteCarlo:
        """Run many simulated trials of a scenario through this navigator.

        Parameters
        ----------
        scenario : celestcore.gnss.GnssStarScenario
            Orbit, attitude and errors.
        trials : int
            How many.
        **options
            Those of `celestcore.gnss.monte_carlo`: `seed`, `smooth`, `skip`, `threads`, ...

        Returns
        -------
        GnssStarMonteCarlo

        Raises
        ------
        InputError, KeyboardInterrupt
            As `celestcore.gnss.monte_carlo`.

        Examples
        --------
        >>> import celestcore as cc
        >>> scenario = cc.gnss.GnssStarScenario(duration=600.0)
        >>> GnssStarNavigator().monte_carlo(scenario, trials=2, seed=1)
        GnssStarMonteCarlo(2 trials of ekf, seed 1)
        """
        from celestcore.gnss.montecarlo import monte_carlo

        return monte_carlo(scenario, self, trials, **options)

    def _camera(self, name: str) -> StarCamera:
        """Return the camera of a star table."""
        if isinstance(self.star, StarCamera):
            return self.star
        if name in self.star:
            camera: StarCamera = self.star[name]
            return camera
        known = ", ".join(self.star) or "none"
        raise InputError(f"no star sensor is described for it; described are {known}", field=name)

    def _orbit_core(self, tables: dict[str, Any] | None) -> _core.GnssOrbit:
        setup, bias = self.filter._setup(), self.gnss.bias
        return _core.GnssOrbit(
            setup["filter"],
            (setup["alpha"], setup["beta"], setup["kappa"]),
            self.dynamics.force._described(),
            tables,
            self.dynamics.accel_psd,
            self.dynamics.max_step,
            None if bias is None else (bias.sigma, bias.tau),
        )

    def _attitude_core(self) -> _core.GnssAttitude:
        tail = [] if self.lfe is None else self.lfe._tail()
        if self.gyro is None:
            return _core.GnssAttitude(self.attitude.jerk_psd, None, tail)
        rk4 = self.filter.integrator == "rk4"
        return _core.GnssAttitude(None, (self.gyro.arw, self.gyro.rrw, rk4), tail)
