"""`StarGyroNavigator`: attitude from a gyro and star cameras, over a log or sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core, _replay
from celestcore._arguments import Sigma0, checked, each_checked, named, one_quaternion
from celestcore._check import number
from celestcore._many import run_many
from celestcore.calibration import Calibration, calibrate
from celestcore.errors import InputError
from celestcore.filters import EKF, UKF, InvariantEKF, IteratedEKF
from celestcore.log import SensorLog
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.solution import Solution
from celestcore.stream import StarGyroState

if TYPE_CHECKING:
    from celestcore.montecarlo import MonteCarlo
    from celestcore.quaternion import QuaternionLike
    from celestcore.simulate import Scenario

__all__ = ["StarGyroNavigator", "StarGyroState"]

FloatArray: TypeAlias = NDArray[np.float64]
AttitudeFilter: TypeAlias = EKF | UKF | IteratedEKF | InvariantEKF
ATTITUDE_SIGMA = 1e-3
"""1-sigma attitude [rad] that `start` assumes if none is given."""
GAP_STEPS = 3.0
"""Steps of a gyro, in medians, beyond which there is a gap if no limit is given."""


class StarGyroNavigator:
    """Attitude and gyro bias from a rate gyro, star cameras and direction sensors.

    State: attitude ``q_ib`` and gyro bias (body frame). Error state, in the order of `sigma` and of
    covariances: attitude error x, y, z (body-frame rotation vector, rad), bias x, y, z (rad/s).

    Parameters
    ----------
    filter : EKF, UKF, SRUKF, IteratedEKF, InvariantEKF or LiteralUKF
        The filter.
    gyro : Gyro
        Noise, sampling and mounting of the gyro.
    star : StarCamera or dict of str to StarCamera
        The camera, or cameras by the names of their tables (``"star"``, ``"star_1"`` ...). One
        camera stands for every star table of a log.
    vector : VectorSensor or dict of str to VectorSensor, optional
        Direction sensors by name, without ``vector_``. One stands for all; a table that brings its
        own noise needs none.
    gate : float, optional
        Probability with which a good measurement passes the chi-square gate, for example 0.9999.
        None: every measurement is used.
    huber : float, optional
        Beyond so many standard deviations a measurement moves the state no farther than there: 1.5
        loses 4 % of the information of good measurements, 3 next to nothing. Within the gate, if
        there is one.
    student_t : float, optional
        Instead of `huber`: weights of a Student distribution with so many degrees of freedom, for
        example 4; the farther off a measurement, the less it moves the state.
    adaptive : float, optional
        Find each sensor's noise while the filter runs, as a factor of its variance, from about so
        many measurements, for example 300; see ``final["noise_scale"]`` of a solution.

    Notes
    -----
    A doubtful measurement counts with a weight w: its innovation's covariance S as S / w. With m
    degrees of freedom and d^2 the NIS, Huber's weight is min(1, k / d), where k is chosen for m
    to be as probable as `huber` for one, Student's min(1, (nu + m) / (nu + d^2)) (Masreliez 1975;
    Chang 2014). Adaptation climbs the likelihood of the innovations, each cut off where 99 % of
    good ones end. A gate is in its way where the noise is more than twice what is told: it then
    refuses nearly all fixes; weights are not. The NIS and innovations in a solution are those of
    the measurement as it came, with the noise found so far. Not with `IteratedEKF`.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> import numpy as np
    >>> import celestcore as cc
    >>> t = np.arange(0.0, 60.0, 0.1)
    >>> rate = np.tile([0.0, 0.0, 0.01], (len(t), 1))
    >>> q = cc.quaternion.propagate([1.0, 0.0, 0.0, 0.0], rate[:-1], 0.1)
    >>> log = cc.SensorLog(gyro=(t, rate), star=(t[::10], q[::10]))
    >>> nav = StarGyroNavigator(cc.UKF(), cc.Gyro(arw=1e-6, rrw=1e-9), cc.StarCamera(5 * cc.ARCSEC))
    >>> sol = nav.run(log)
    >>> float(cc.quaternion.angle_between(sol.q[-1], q[-1])) < 1 * cc.ARCSEC
    True
    """

    def __init__(
        self,
        filter: AttitudeFilter | None = None,  # noqa: A002 - the field's word
        gyro: Gyro | None = None,
        star: StarCamera | Mapping[str, StarCamera] | None = None,
        vector: VectorSensor | Mapping[str, VectorSensor] | None = None,
        *,
        gate: float | None = None,
        huber: float | None = None,
        student_t: float | None = None,
        adaptive: float | None = None,
    ) -> None:
        if gyro is None:
            raise InputError("is needed: Gyro(arw=..., rrw=...)", field="gyro")
        self.filter: AttitudeFilter = checked(
            EKF() if filter is None else filter, "filter", EKF, UKF, IteratedEKF, InvariantEKF
        )
        self.gyro: Gyro = checked(gyro, "gyro", Gyro)
        self.star: StarCamera | Mapping[str, StarCamera] = each_checked(
            StarCamera() if star is None else star, "star", StarCamera
        )
        self.vector: VectorSensor | Mapping[str, VectorSensor] | None = (
            None if vector is None else each_checked(vector, "vector", VectorSensor)
        )
        self.gate = None if gate is None else number(gate, "gate", above=0.0)
        if self.gate is not None and self.gate > 1.0:
            raise InputError(
                "is a probability, for example 0.9999; 1 accepts all", field="gate", value=gate
            )
        self.huber = None if huber is None else number(huber, "huber", above=0.0)
        self.student_t = None if student_t is None else number(student_t, "student_t", above=0.0)
        self.adaptive = None if adaptive is None else number(adaptive, "adaptive", above=0.0)
        self._check_weights()
        self._check_frames()

    def __repr__(self) -> str:
        more = "".join(
            f", {name}={value}" for name, value in self._weights().items() if value is not None
        )
        return (
            f"StarGyroNavigator({self.filter!r}, {self.gyro!r}, {self.star!r}, {self.vector!r}, "
            f"gate={self.gate}{more})"
        )

    def run(
        self,
        log: SensorLog,
        *,
        t0: float | None = None,
        q0: QuaternionLike | None = None,
        bias0: ArrayLike = (0.0, 0.0, 0.0),
        sigma0: Sigma0 | None = None,
        covariance0: ArrayLike | None = None,
        noise_scale0: Mapping[str, float] | None = None,
        every: int = 1,
        period: float | None = None,
        covariance: bool = False,
        innovations: str = "full",
        progress: Callable[[int, int], object] | None = None,
        portable: bool = False,
    ) -> Solution:
        """Replay a log.

        Parameters
        ----------
        log : SensorLog
            With a gyro; sensors at their own times, merged by time.
        t0 : float, optional
            Start [s since the log's epoch]; by default the first gyro sample if `q0` is given.
        q0 : array_like (4,) or scipy Rotation, optional
            Attitude ``q_ib`` at `t0`. By default the start is the first star fix that most of the
            next few agree with; rows before it are left out.
        bias0 : array_like (3,)
            Gyro bias at the start, body frame [rad/s].
        sigma0 : (attitude, bias), optional
            1-sigma of the start [rad], [rad/s], each a number or three. By default the first fix's
            own noise, and 1e-3 rad/s. Needed with `q0`; without it only the bias part is used.
        covariance0 : array_like (6, 6), optional
            Full covariance of the start with `q0`, instead of `sigma0`; for going on from the
            ``final`` of another solution.
        noise_scale0 : dict of str to float, optional
            With an adaptive navigator: what the variance of each sensor's noise is multiplied by
            at the start, as ``final["noise_scale"]`` of another solution; by default 1.
        every : int
            One output row every so many gyro samples.
        period : float, optional
            One output row every so many seconds from the start instead; the filter runs as without.
        covariance : bool
            Whether to keep full 6x6 covariances at the output rate.
        innovations : {"full", "nis", "none"}
            What to keep of each measurement: ``"full"`` keeps its NIS, whether it was accepted, its
            innovation and the innovation's sigma (73 bytes); ``"nis"`` leaves out the last two
            (25 bytes); ``"none"`` keeps nothing but `Solution.counts` and the likelihood, for
            logs of any length in little memory.
        progress : callable, optional
            ``progress(done, total)`` [gyro samples], called some 20 times a second.
        portable : bool
            Compute without the wide instructions of this machine: same bits on every x86-64
            machine, slower.

        Returns
        -------
        Solution

        Raises
        ------
        InputError
            No gyro, no star fix to start from, noise that is not given, a bad start.
        NumericalError
            A covariance that is no longer positive definite; names step and time.
        KeyboardInterrupt
            On Ctrl-C, within a fraction of a second.

        Notes
        -----
        The log is read where it is. Beyond it a run takes 136 bytes for each output row (424 with
        `covariance`), what `innovations` says for each measurement, and two bytes for each to
        merge several sensors.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = cc.Settings.from_log(log).navigator().run(log, every=10)
        >>> sol.counts["accepted"], sol.sigma.shape[1]
        (43194, 6)
        """
        given = {
            "t0": t0,
            "q0": q0,
            "bias0": bias0,
            "sigma0": sigma0,
            "covariance0": covariance0,
            "noise_scale0": noise_scale0,
            "every": every,
            "period": period,
            "covariance": covariance,
            "innovations": innovations,
            "progress": progress,
            "portable": portable,
        }
        call, names = _replay.prepare(self, log, given)
        out = _core.replay(call, False)
        return _replay.finish(self, log, names, call, out, source=(log, given))

    def run_many(
        self, logs: Iterable[SensorLog], *, threads: int | None = None, **options: Any
    ) -> list[Solution | None]:
        """Replay many logs: eight side by side in vector registers, over threads.

        For fleets and archives. Logs need not be of equal length or times, but those that are go
        in step and are fastest: put like beside like.

        Parameters
        ----------
        logs : iterable of SensorLog
            Each with a gyro.
        threads : int, optional
            By default all processors. The results are the same bits for any number.
        **options
            Those of `run`, for all logs. ``progress`` hears of (done, total) logs.

        Returns
        -------
        list of Solution or None
            In the order of the logs; None where the filter broke down, with a warning that says
            why. Every solution's ``elapsed_s`` is that of the whole call in the core.

        Raises
        ------
        InputError, KeyboardInterrupt
            As `run`; names the number of the log. Nothing has been run then.

        Warns
        -----
        CelestcoreWarning
            Where a filter broke down.

        Notes
        -----
        EKF and UKF on gyro and star cameras run side by side where the processor has AVX2, and
        agree with `run` to rounding. Other filters, direction sensors, an output by ``period`` and
        ``portable`` run one log at a time, over the threads. A log's result does not depend on
        the others.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> nav = cc.Settings.from_log(log).navigator()
        >>> first, second = nav.run_many([log, log], every=100)
        >>> bool((first.q == second.q).all())
        True
        """
        return run_many(self, logs, threads, options)

    def smooth(self, log: SensorLog | Solution, **options: Any) -> Solution:
        """Replay a log forward and back: every row knows the measurements before and after it.

        For processing on the ground; a smoother is not causal. Rauch-Tung-Striebel on the
        manifold, for every filter (Rauch, Tung, Striebel 1965; Sarkka 2008 for sigma points).

        Parameters
        ----------
        log : SensorLog or Solution
            A log, or what `run` returned for it: the same log is then replayed with the same
            options.
        **options
            Those of `run`, except `period`: rows are at gyro samples.

        Returns
        -------
        Solution
            With ``smoothed=True``. `nis`, `accepted` and `innovation` are those of the forward
            pass; ``final`` is the filter's own, which the smoother does not change.

        Raises
        ------
        InputError, NumericalError, KeyboardInterrupt
            As `run`.

        Notes
        -----
        Memory: some 300 bytes for each step between samples and fixes, beside the rows: 0.3 GB
        for a day at 10 Hz.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> nav = cc.Settings.from_log(log).navigator()
        >>> sol = nav.run(log)
        >>> best = nav.smooth(sol)
        >>> bool((best.sigma[:-1, 3:] < sol.sigma[:-1, 3:]).all())
        True
        """
        if isinstance(log, Solution):
            if log.source is None:
                raise InputError(
                    "does not know its log any more; give the SensorLog instead", field="log"
                )
            log, given = log.source
            options = {**given, **options}
        call, names = _replay.prepare(self, log, options)
        out = _core.replay(call, True)
        return _replay.finish(self, log, names, call, out, source=(log, options), smoothed=True)

    def calibrate(
        self,
        log: SensorLog,
        *,
        scale_sigma: float = 0.01,
        misalignment_sigma: float = 0.01,
        alignment_sigma: float = 0.01,
        aligned: str | None = None,
        **options: Any,
    ) -> Calibration:
        """Estimate the gyro's scale factors and misalignments and a camera's alignment.

        An extended Kalman filter on 18 error states: attitude, bias, the nine entries of the
        gyro's error matrix M in ``rate_measured = (I + M) rate + bias``, and the rotation between
        two cameras. What the log's motion does not show stays at its prior; see
        `Calibration.ratio`. The navigator's own filter is not used.

        The filter is guided by the smoothed attitude: the rate that gyro errors are in proportion
        to comes from there, not from the noisy readings, whose noise would pass for a scale factor
        (errors in variables). It goes over the log six times.

        Parameters
        ----------
        log : SensorLog
            With a gyro and star cameras, best with slews about several axes.
        scale_sigma : float
            1-sigma of the scale factors beforehand.
        misalignment_sigma : float
            1-sigma of the misalignments beforehand [rad].
        alignment_sigma : float
            1-sigma of the alignment beforehand [rad].
        aligned : str, optional
            Name of the star table whose alignment against the others is estimated; by default
            the second one, if there are two.
        **options
            Those of `run`.

        Returns
        -------
        Calibration

        Raises
        ------
        InputError, NumericalError, KeyboardInterrupt
            As `run`; also more than two cameras without `aligned`.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> found = cc.Settings.from_log(log).navigator().calibrate(log)
        >>> bool(found.ratio["scale_x"] < 0.5)
        True
        """
        return calibrate(
            self, log, (scale_sigma, misalignment_sigma, alignment_sigma), aligned, options
        )

    def monte_carlo(self, scenario: Scenario, trials: int = 100, **options: Any) -> MonteCarlo:
        """Run many simulated trials of a scenario through this navigator.

        Parameters
        ----------
        scenario : celestcore.simulate.Scenario
            Truth and sensor errors.
        trials : int
            How many.
        **options
            Those of `celestcore.monte_carlo`: `seed`, `smooth`, `skip`, `threads`, `executor`, ...

        Returns
        -------
        MonteCarlo

        Raises
        ------
        InputError, KeyboardInterrupt
            As `celestcore.monte_carlo`.

        Examples
        --------
        >>> import celestcore as cc
        >>> truth = cc.simulate.constant_rate([0.0, 0.0, 1e-3], 100.0)
        >>> gyro, star = cc.simulate.GyroErrors(1e-6), cc.simulate.StarErrors(1e-5, period=1.0)
        >>> scenario = cc.simulate.Scenario(truth, gyro, star)
        >>> runs = scenario.navigator(cc.EKF()).monte_carlo(scenario, trials=4, seed=1)
        >>> [scores.rms.shape for scores in runs.values()]
        [(4, 3)]
        """
        from celestcore.montecarlo import monte_carlo

        return monte_carlo(scenario, self, trials, **options)

    def start(
        self,
        t: float,
        q: QuaternionLike,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        sigma0: Sigma0 | None = None,
        covariance0: ArrayLike | None = None,
        lag: float | None = None,
    ) -> StarGyroState:
        """Start a filter that is fed sample by sample.

        Parameters
        ----------
        t : float
            Time of the start [s].
        q : array_like (4,) or scipy Rotation
            Attitude ``q_ib`` then.
        bias : array_like (3,)
            Gyro bias then, body frame [rad/s].
        sigma0 : (attitude, bias), optional
            1-sigma of both [rad], [rad/s], each a number or three; by default 1e-3 rad and
            1e-3 rad/s.
        covariance0 : array_like (6, 6), optional
            Full covariance of the error state instead.
        lag : float, optional
            How far back to remember the steps [s], for `StarGyroState.smoothed`.

        Returns
        -------
        StarGyroState

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
        >>> state.predict(0.0, [0.0, 0.0, 0.01])
        >>> state.predict(0.1, [0.0, 0.0, 0.01])
        >>> state.update(0.1, cc.quaternion.exp([0.0, 0.0, 0.001])).accepted
        True
        """
        if sigma0 is None and covariance0 is None:
            sigma0 = (ATTITUDE_SIGMA, _replay.BIAS_SIGMA)
        begin = number(t, "t")
        attitude = one_quaternion(q, "q")
        return StarGyroState(self, begin, attitude, bias, sigma0, covariance0, lag)

    def _setup(self, max_gap: float) -> dict[str, Any]:
        return {
            **self.filter._setup(),
            "arw": self.gyro.arw,
            "rrw": self.gyro.rrw,
            "sampling": self.gyro.sampling,
            "max_gap": max_gap,
            "gap_rate_sigma": self.gyro.gap_rate_sigma,
            "gate": 1.0 if self.gate is None else self.gate,
            "robust": self._robust(),
            "adaptive": self.adaptive,
        }

    def _robust(self) -> tuple[str, float]:
        if self.huber is not None:
            return "huber", self.huber
        return ("full", 0.0) if self.student_t is None else ("student_t", self.student_t)

    def _weights(self) -> dict[str, float | None]:
        """Return how doubtful measurements are weighed, as arguments."""
        return {"huber": self.huber, "student_t": self.student_t, "adaptive": self.adaptive}

    def _like(self, **changes: Any) -> StarGyroNavigator:
        """Return a navigator with some arguments changed."""
        own = {"filter": self.filter, "gyro": self.gyro, "star": self.star, "vector": self.vector}
        return type(self)(**{**own, "gate": self.gate, **self._weights(), **changes})

    def _check_weights(self) -> None:
        if self.huber is not None and self.student_t is not None:
            raise InputError("give huber or student_t, not both", field="huber", value=self.huber)
        for name, value in self._weights().items():
            if value is not None and isinstance(self.filter, IteratedEKF):
                raise InputError("does not go with IteratedEKF", field=name, value=value)

    def _check_frames(self) -> None:
        """All sensors must lead to the same body frame."""
        found = {"gyro": self.gyro.frame}
        for kind, given in (("star", self.star), ("vector", self.vector)):
            if isinstance(given, Mapping):
                found.update({name: sensor.frame for name, sensor in given.items()})
            elif given is not None:
                found[kind] = given.frame
        if len(set(found.values())) > 1:
            listed = ", ".join(f"{name} to {frame!r}" for name, frame in found.items())
            raise InputError(
                f"the sensors' mountings lead to different body frames: {listed}", field="frame"
            )

    def _camera(self, name: str) -> StarCamera:
        return self.star if isinstance(self.star, StarCamera) else named(self.star, name, "star")

    def _direction(self, name: str) -> VectorSensor | None:
        if self.vector is None or isinstance(self.vector, VectorSensor):
            return self.vector
        sensor: VectorSensor = named(self.vector, name, "vector")
        return sensor

    def _max_gap(self, t: FloatArray) -> float:
        if self.gyro.max_gap is not None:
            return self.gyro.max_gap
        return _core.longest_step(np.ascontiguousarray(t), GAP_STEPS)
