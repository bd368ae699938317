"""`StarGyroNavigator`: attitude from a gyro and star cameras, over a log or sample by sample."""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import (
    QUATERNION_HINT,
    array,
    covariances,
    directions,
    number,
    quaternion,
    unit_rows,
)
from celestcore.errors import InputError
from celestcore.filters import EKF, UKF
from celestcore.log import SensorLog
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.solution import Solution

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

__all__ = ["StarGyroNavigator", "StarGyroState"]

FloatArray: TypeAlias = NDArray[np.float64]
Sigma0: TypeAlias = "tuple[ArrayLike, ArrayLike]"
BIAS_SIGMA = 1e-3
"""1-sigma gyro bias [rad/s] that a start assumes if none is given (200 deg/h)."""
GAP_STEPS = 10.0
"""Steps of a gyro, in medians, beyond which there is a gap if no limit is given."""


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
        self.filter: EKF | UKF = _checked(EKF() if filter is None else filter, "filter", EKF, UKF)
        self.gyro: Gyro = _checked(gyro, "gyro", Gyro)
        self.star: StarCamera | Mapping[str, StarCamera] = _each(
            StarCamera() if star is None else star, "star", StarCamera
        )
        self.vector: VectorSensor | Mapping[str, VectorSensor] | None = (
            None if vector is None else _each(vector, "vector", VectorSensor)
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
        gyro = _checked(log, "log", SensorLog).gyro
        if gyro is None:
            raise InputError("the log has no gyro table; it has " + ", ".join(log.tables))
        if progress is not None and not callable(progress):
            raise InputError("must be callable as progress(done, total)", field="progress")
        names, sensors = self._sensors(log)
        max_gap = self._max_gap(gyro.t)
        out = _core.replay(
            gyro_t=gyro.t,
            gyro_rate=self.gyro.to_body(gyro.rate),
            sensors=sensors,
            setup=self._setup(max_gap),
            start=self._start(gyro.t, t0, q0, sigma0),
            bias0=_three(bias0, "bias0"),
            bias_sigma=[BIAS_SIGMA] * 3 if sigma0 is None else _sigma0(sigma0)[3:].tolist(),
            every=_count(every, "every"),
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
        sigma0: Sigma0 = (1e-3, BIAS_SIGMA),
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
        sigma0 : (attitude, bias)
            1-sigma of both [rad], [rad/s], each a number or three.

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
        return StarGyroState(self, number(t, "t"), _quaternion(q, "q"), bias, sigma0)

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
        return self.star if isinstance(self.star, StarCamera) else _named(self.star, name, "star")

    def _direction(self, name: str) -> VectorSensor | None:
        if self.vector is None or isinstance(self.vector, VectorSensor):
            return self.vector
        sensor: VectorSensor = _named(self.vector, name, "vector")
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
    ) -> tuple[float, tuple[float, ...], FloatArray] | None:
        if q0 is None:
            if t0 is not None:
                raise InputError("goes with q0, the attitude then", field="t0", value=t0)
            return None
        if sigma0 is None:
            raise InputError("is needed with q0: (attitude [rad], bias [rad/s])", field="sigma0")
        if len(t) == 0:
            raise InputError("has no samples", field="gyro")
        begin = float(t[0]) if t0 is None else number(t0, "t0")
        return begin, _quaternion(q0, "q0"), _covariance(sigma0)

    def _solution(
        self, log: SensorLog, names: list[str], out: dict[str, Any], max_gap: float
    ) -> Solution:
        gyro = log.gyro
        assert gyro is not None
        steps = np.diff(gyro.t)
        first = np.flatnonzero(steps > max_gap)
        accepted = out["accepted"]
        used = int(np.count_nonzero(accepted))
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


class StarGyroState(_core.AttitudeStream):
    """A filter that is fed sample by sample: what `StarGyroNavigator.start` returns.

    Samples come in order of time: `predict` with each gyro sample, `update` with each star fix,
    `update_direction` with each direction. The result is that of `StarGyroNavigator.run` on the
    same samples, except where a measurement falls between two gyro samples and the gyro's sampling
    is "integrated" or "average": the sample that ends the interval is then not known yet, and the
    last one is held. Without `Gyro.max_gap` no step is a gap: a stream knows no median step.

    Attributes
    ----------
    t : float
        Time of the state [s].
    q : ndarray (4,)
        Attitude ``q_ib``.
    rate : ndarray (3,) or None
        Latest gyro sample less the bias, body frame [rad/s].
    bias : ndarray (3,)
        Gyro bias, body frame [rad/s].
    sigma : ndarray (6,)
        1-sigma of the error state [rad], [rad/s].
    covariance : ndarray (6, 6)
        Covariance of the error state.
    """

    navigator: StarGyroNavigator

    def __new__(
        cls,
        navigator: StarGyroNavigator,
        t: float,
        q: Sequence[float],
        bias: ArrayLike,
        sigma0: Sigma0,
    ) -> StarGyroState:
        """Make the core's state."""
        gap = navigator.gyro.max_gap
        setup = navigator._setup(np.inf if gap is None else gap)
        mounting: Any = navigator.gyro.mounting  # a plain tuple since Gyro was made
        self = super().__new__(
            cls, setup, mounting, t, q, _three(bias, "bias"), _covariance(sigma0)
        )
        self.navigator = navigator
        return self

    def update(
        self,
        t: float,
        q: QuaternionLike,
        *,
        camera: str = "star",
        sigma: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
    ) -> _core.Update:
        """Correct by a star fix.

        Parameters
        ----------
        t : float
            Its time [s], not before the state's.
        q : array_like (4,) or scipy Rotation
            Camera to inertial, either sign (body to inertial if the camera has no mounting).
        camera : str
            Name of the camera, if there are several.
        sigma : float or array_like (3,), optional
            1-sigma of this fix in camera axes [rad]; by default the camera's.
        covariance : array_like (3, 3), optional
            Its covariance instead [rad^2].

        Returns
        -------
        Update
            With ``accepted``, ``nis``, ``dof``, ``innovation`` (3,) and its ``covariance`` (3, 3).

        Raises
        ------
        InputError
            A bad quaternion, or a time before the state's; the state is as it was.
        NumericalError
            A covariance that is not positive definite; the state is as it was.
        """
        own = self.navigator._camera(camera)
        each = None if sigma is None else np.reshape(_positive(sigma, "sigma"), (1, 3))
        full = None
        if covariance is not None:
            full = array(covariance, "covariance", (3, 3))[None]
            full = covariances(full, "covariance", 1, one=True)
        q_ib, noise = own.to_body(np.reshape(_quaternion(q, "q"), (1, 4)), each, full)
        return self.update_star(number(t, "t"), q_ib[0].tolist(), noise[0].tolist())

    def update_direction(
        self,
        t: float,
        body: ArrayLike,
        inertial: ArrayLike,
        *,
        sensor: str | None = None,
        sigma: float | None = None,
    ) -> _core.Update:
        """Correct by a direction: a star, the Sun, the magnetic field.

        Parameters
        ----------
        t : float
            Its time [s], not before the state's.
        body : array_like (3,)
            Measured direction in the sensor's frame, any length.
        inertial : array_like (3,)
            The same direction in the inertial frame, any length.
        sensor : str, optional
            Name of the sensor, if there are several.
        sigma : float, optional
            1-sigma of this one [rad]; by default the sensor's.

        Returns
        -------
        Update
            With ``accepted``, ``nis``, ``dof``, ``innovation`` (2,) and its ``covariance`` (2, 2).

        Raises
        ------
        InputError
            A vector without direction, no noise, a time before the state's.
        """
        nav = self.navigator
        own = nav._direction(sensor or "") if nav.vector is not None else None
        if sigma is None and own is None:
            raise InputError("is needed: the navigator has no vector sensor", field="sigma")
        given = own.sigma if sigma is None and own is not None else sigma
        noise = number(given, "sigma", above=0.0)
        plain = own if own is not None else VectorSensor(noise)
        b = plain.to_body(directions(array(body, "body", (3,))[None], "body"))[0]
        i = directions(array(inertial, "inertial", (3,))[None], "inertial")[0]
        i /= np.linalg.norm(i)
        return self.update_vector(number(t, "t"), b.tolist(), i.tolist(), noise)

    @property
    def sigma(self) -> FloatArray:
        """1-sigma of the error state (6,) [rad], [rad/s]."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def rate(self) -> FloatArray | None:
        """Latest gyro sample less the bias (3,) [rad/s], None before the first."""
        last = self._snapshot()[4]
        return None if last is None else np.asarray(last[1]) - self.bias

    def copy(self) -> StarGyroState:
        """Return a copy that goes its own way."""
        return copy.copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.navigator, self._snapshot()), self.__dict__

    def __repr__(self) -> str:
        sigma = ", ".join(f"{s:.3g}" for s in self.sigma)
        return f"StarGyroState(t={self.t:.10g}, q={self.q.round(9).tolist()}, sigma=[{sigma}])"


def _restore(
    cls: type[StarGyroState], navigator: StarGyroNavigator, parts: tuple[Any, ...]
) -> StarGyroState:
    state = StarGyroState.__new__(cls, navigator, parts[0], parts[1], parts[2], (1.0, 1.0))
    state._restore(parts)
    return state


def _named(sensors: Mapping[str, Any], name: str, what: str) -> Any:
    if name in sensors:
        return sensors[name]
    known = ", ".join(sensors) or "none"
    raise InputError(f"no {what} sensor is described for it; described are {known}", field=name)


def _checked(value: Any, field: str, *kinds: type) -> Any:
    if isinstance(value, kinds):
        return value
    known = " or ".join(f"{kind.__name__}(...)" for kind in kinds)
    shown = value if isinstance(value, str | int | float) else type(value).__name__
    raise InputError(f"must be {known}", field=field, value=shown)


def _each(value: Any, field: str, kind: type) -> Any:
    """Check one sensor, or a mapping of names to sensors."""
    if not isinstance(value, Mapping):
        return _checked(value, field, kind)
    return {name: _checked(sensor, str(name), kind) for name, sensor in value.items()}


def _quaternion(q: QuaternionLike, field: str) -> tuple[float, ...]:
    """Return one unit quaternion; rounding is normalised, what is further off is an error."""
    value = quaternion(q, field)
    if value.size != 4:
        raise InputError(f"needs one quaternion, got shape {value.shape}", field=field)
    rows = value.reshape(1, 4)
    if not np.isfinite(rows).all():
        raise InputError("must be finite", field=field, value=rows[0])
    try:
        unit_rows(rows, field, what="quaternion", hint=QUATERNION_HINT)
    except InputError as error:
        error.row = None
        raise
    return tuple(rows[0].tolist())


def _three(value: ArrayLike, field: str) -> list[float]:
    """Return three finite numbers of one or three."""
    a = array(value, field)
    if a.shape not in ((), (1,), (3,)) or not np.all(np.isfinite(a)):
        raise InputError("needs one finite number or three", field=field, value=a.tolist())
    return [float(x) for x in np.broadcast_to(a, (3,))]


def _count(value: int, field: str) -> int:
    n = number(value, field)
    if n != np.floor(n) or n < 1.0:
        raise InputError("must be a whole number of at least 1", field=field, value=value)
    return int(min(n, 2.0**53))


def _positive(value: ArrayLike, field: str) -> FloatArray:
    """Return three 1-sigma values of one or three."""
    sigma = np.array(_three(value, field))
    if not np.all(sigma > 0.0):
        raise InputError("must be positive", field=field, value=sigma)
    return sigma


def _sigma0(sigma0: Sigma0) -> FloatArray:
    """Return the start's 1-sigma values (6,): attitude [rad], bias [rad/s]."""
    pair = isinstance(sigma0, Sequence) or (isinstance(sigma0, np.ndarray) and sigma0.ndim > 0)
    if not pair or len(sigma0) != 2:
        raise InputError("needs (attitude [rad], bias [rad/s])", field="sigma0", value=sigma0)
    return np.concatenate([_positive(part, "sigma0") for part in sigma0])


def _covariance(sigma0: Sigma0) -> FloatArray:
    sigma = _sigma0(sigma0)
    with np.errstate(over="ignore"):  # the core refuses what is not finite
        return np.diag(sigma * sigma)
