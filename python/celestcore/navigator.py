"""`StarGyroNavigator`: attitude from a gyro and star cameras, over a log or sample by sample."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._arguments import (
    Sigma0,
    checked,
    count,
    covariance_of,
    each_checked,
    named,
    one_quaternion,
    sigma_of,
    three,
)
from celestcore._check import number, warn
from celestcore.errors import InputError
from celestcore.filters import EKF, UKF
from celestcore.log import SensorLog
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.solution import Solution
from celestcore.stream import StarGyroState

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

__all__ = ["StarGyroNavigator", "StarGyroState"]

FloatArray: TypeAlias = NDArray[np.float64]
ATTITUDE_SIGMA = 1e-3
"""1-sigma attitude [rad] that `start` assumes if none is given."""
BIAS_SIGMA = 1e-3
"""1-sigma gyro bias [rad/s] that a start assumes if none is given (200 deg/h)."""
GAP_STEPS = 3.0
"""Steps of a gyro, in medians, beyond which there is a gap if no limit is given."""
REJECTED = 0.5
"""Share of measurements outside the gate beyond which a run warns."""


class StarGyroNavigator:
    """Attitude and gyro bias from a rate gyro, star cameras and direction sensors.

    State: attitude ``q_ib`` and gyro bias (body frame). Error state, in the order of `sigma` and of
    covariances: attitude error x, y, z (body-frame rotation vector, rad), bias x, y, z (rad/s).

    Parameters
    ----------
    filter : EKF, UKF or SRUKF
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
        filter: EKF | UKF | None = None,  # noqa: A002 - the field's word
        gyro: Gyro | None = None,
        star: StarCamera | Mapping[str, StarCamera] | None = None,
        vector: VectorSensor | Mapping[str, VectorSensor] | None = None,
        *,
        gate: float | None = None,
    ) -> None:
        if gyro is None:
            raise InputError("is needed: Gyro(arw=..., rrw=...)", field="gyro")
        self.filter: EKF | UKF = checked(EKF() if filter is None else filter, "filter", EKF, UKF)
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
        self._check_frames()

    def __repr__(self) -> str:
        return (
            f"StarGyroNavigator({self.filter!r}, {self.gyro!r}, {self.star!r}, {self.vector!r}, "
            f"gate={self.gate})"
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
        every: int = 1,
        period: float | None = None,
        covariance: bool = False,
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
        every : int
            One output row every so many gyro samples.
        period : float, optional
            One output row every so many seconds from the start instead; the filter runs as without.
        covariance : bool
            Whether to keep full 6x6 covariances at the output rate.
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
        """
        gyro = checked(log, "log", SensorLog).gyro
        if gyro is None:
            raise InputError("the log has no gyro table; it has " + ", ".join(log.tables))
        if progress is not None and not callable(progress):
            raise InputError("must be callable as progress(done, total)", field="progress")
        if period is not None and every != 1:
            raise InputError("goes without every: give one of them", field="period", value=period)
        names, sensors = self._sensors(log)
        max_gap = self._max_gap(gyro.t)
        out = _core.replay(
            gyro_t=gyro.t,
            gyro_rate=self.gyro.to_body(gyro.rate),
            sensors=sensors,
            setup=self._setup(max_gap),
            start=self._start(gyro.t, t0, q0, sigma0, covariance0),
            bias0=three(bias0, "bias0"),
            bias_sigma=[BIAS_SIGMA] * 3 if sigma0 is None else sigma_of(sigma0)[3:].tolist(),
            every=count(every, "every"),
            period=None if period is None else number(period, "period", above=0.0),
            covariance=bool(covariance),
            portable=bool(portable),
            progress=progress,
        )
        return self._solution(log, names, out, max_gap)

    def start(
        self,
        t: float,
        q: QuaternionLike,
        bias: ArrayLike = (0.0, 0.0, 0.0),
        sigma0: Sigma0 | None = None,
        covariance0: ArrayLike | None = None,
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
            sigma0 = (ATTITUDE_SIGMA, BIAS_SIGMA)
        begin = number(t, "t")
        return StarGyroState(self, begin, one_quaternion(q, "q"), bias, sigma0, covariance0)

    def _setup(self, max_gap: float) -> dict[str, Any]:
        return {
            **self.filter._setup(),
            "arw": self.gyro.arw,
            "rrw": self.gyro.rrw,
            "sampling": self.gyro.sampling,
            "max_gap": max_gap,
            "gap_rate_sigma": self.gyro.gap_rate_sigma,
            "gate": 1.0 if self.gate is None else self.gate,
        }

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

    def _sensors(self, log: SensorLog) -> tuple[list[str], list[tuple[Any, ...]]]:
        """Return the sensors' names, and their columns in the body frame for the core."""
        names: list[str] = []
        sensors: list[tuple[Any, ...]] = []
        for name, star in log.stars.items():
            q, noise = self._camera(name).to_body(star.q, star.sigma, star.covariance)
            names.append(name)
            sensors.append(("star", star.t, q, noise))
        for name, table in log.vectors.items():
            sensor = self._direction(name)
            sigma = table.sigma
            if sigma is None:
                if sensor is None:
                    raise InputError(
                        "has no noise; give StarGyroNavigator(vector=VectorSensor(sigma=...))",
                        field=f"vector_{name}.sigma",
                    )
                sigma = np.full(len(table), sensor.sigma)
            body = table.body if sensor is None else sensor.to_body(table.body)
            names.append(f"vector_{name}")
            sensors.append(("vector", table.t, body, table.inertial, sigma))
        return names, sensors

    def _max_gap(self, t: FloatArray) -> float:
        if self.gyro.max_gap is not None:
            return self.gyro.max_gap
        return GAP_STEPS * float(np.median(np.diff(t))) if len(t) > 1 else np.inf

    def _start(
        self,
        t: FloatArray,
        t0: float | None,
        q0: QuaternionLike | None,
        sigma0: Sigma0 | None,
        covariance0: ArrayLike | None,
    ) -> tuple[float, tuple[float, ...], FloatArray] | None:
        if q0 is None:
            if t0 is not None:
                raise InputError("goes with q0, the attitude then", field="t0", value=t0)
            if covariance0 is not None:
                raise InputError("goes with q0, the attitude then", field="covariance0")
            return None
        if len(t) == 0:
            raise InputError("has no samples", field="gyro")
        begin = float(t[0]) if t0 is None else number(t0, "t0")
        if not t[0] <= begin <= t[-1]:
            raise InputError(
                f"must lie within the gyro's time span, {t[0]:.10g} to {t[-1]:.10g} s",
                field="t0",
                value=begin,
            )
        return begin, one_quaternion(q0, "q0"), covariance_of(sigma0, covariance0)

    def _solution(
        self, log: SensorLog, names: list[str], out: dict[str, Any], max_gap: float
    ) -> Solution:
        gyro = log.gyro
        assert gyro is not None
        steps = np.diff(gyro.t)
        first = np.flatnonzero(steps > max_gap)
        accepted = out["accepted"]
        used = int(np.count_nonzero(accepted))
        if len(accepted) - used > max(10, REJECTED * len(accepted)):
            warn(
                f"{len(accepted) - used} of {len(accepted)} measurements were outside the gate: "
                "the start, the noise or the frames are probably wrong"
            )
        start_fix = out["start_fix"] is not None
        p_final = out["final_covariance"]
        fixes = sum(len(table) for table in (*log.stars.values(), *log.vectors.values()))
        return Solution(
            **{name: out[name] for name in ("t", "q", "rate", "bias", "sigma", "measurement_t")},
            **{name: out[name] for name in ("sensor", "nis", "dof", "accepted", "innovation")},
            innovation_sigma=out["innovation_sigma"],
            covariance=out["covariance"] if len(out["covariance"]) else None,
            gaps=np.stack([gyro.t[first], gyro.t[first + 1]], axis=1),
            counts={
                "samples": len(gyro),
                "fixes": fixes,
                "accepted": used,
                "rejected": len(accepted) - used,
                "start": int(start_fix),
                "missing": log.missing,
                "outside": int(out["outside"]),
                "gaps": len(first),
            },
            sensor_names=names,
            epoch=log.epoch,
            title=log.title,
            filter=self.filter.kind,
            elapsed_s=out["elapsed_s"],
            final={
                "t": out["final_t"],
                "q": out["final_q"],
                "bias": out["final_bias"],
                "sigma": np.sqrt(np.diag(p_final)),
                "covariance": p_final,
            },
            frames=log.frames,
        )
