"""Errors of simulated sensors."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import count, three
from celestcore._check import FloatArray, array, mounting, number
from celestcore.errors import InputError
from celestcore.sensors import StarCamera

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike
    from celestcore.simulate._truth import Truth

Three = tuple[float, float, float]


@dataclass(frozen=True)
class GyroErrors:
    """Errors of a gyro with three axes, all in the gyro's frame.

    Reading k is the mean from t_k to t_k+1 of ``(I + M) w + b + d + n`` (`Gyro`'s sampling
    ``"hold"``): ``w`` the true rate, ``n`` white noise, ``b`` the bias, a random walk, and ``d`` a
    first-order Markov drift (Wang and Jiang 2020, eq. 8). What the walk and the drift do within a
    step is drawn together with where they end (Farrenkopf 1978; Gillespie 1996), so the readings
    do not depend on the step. Each number may be one for all axes or three.

    Parameters
    ----------
    arw : float or array_like (3,)
        Angle random walk [rad/sqrt(s)]; 0 for none.
    rrw : float or array_like (3,)
        Rate random walk of the bias [rad/s/sqrt(s)].
    bias : float or array_like (3,)
        Mean of the bias at the start [rad/s].
    bias_sigma : float or array_like (3,)
        1-sigma of the bias at the start about it [rad/s], drawn anew in each trial.
    markov_sigma : float or array_like (3,)
        1-sigma of the drift in its steady state, from which it also starts [rad/s].
    markov_time : float
        Correlation time of the drift [s]; infinite: the drift is constant.
    scale : float or array_like (3,)
        Scale factor errors: 1e-3 reads a thousandth too much.
    misalignment : array_like (6,) or (3, 3)
        Misalignments [rad] in the order xy, xz, yx, yz, zx, zy: ``xy`` is how much of the rate
        about y the x axis reads. A matrix is added to the scale factors' diagonal.
    quantisation : float
        Smallest step of an angle that the gyro reports [rad]. The rest is carried to the next
        reading, nothing is lost.
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bg``, scalar first, gyro frame to body.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    The reading holds the mean of the rate, as an integrating gyro's does. A filter's process noise
    is that of a continuously integrated attitude; in a step of rotation angle ``a`` the reading's
    white noise is below it by a share of ``a**2 / 12`` across the axis: 1e-5 at 0.01 rad.

    Examples
    --------
    >>> from celestcore.units import ARCSEC, ARCSEC_PER_S
    >>> from celestcore.simulate import GyroErrors
    >>> # 0.2 arcsec/s (3 sigma) white in each 0.1 s
    >>> gyro = GyroErrors(arw=0.2 * ARCSEC / 3 * 0.1**0.5, bias_sigma=1 * ARCSEC_PER_S)
    >>> gyro.rrw
    (0.0, 0.0, 0.0)
    """

    arw: ArrayLike = 0.0
    rrw: ArrayLike = 0.0
    bias: ArrayLike = 0.0
    bias_sigma: ArrayLike = 0.0
    markov_sigma: ArrayLike = 0.0
    markov_time: float = np.inf
    scale: ArrayLike = 0.0
    misalignment: ArrayLike = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    quantisation: float = 0.0
    _: KW_ONLY
    mounting: QuaternionLike | None = None

    def __post_init__(self) -> None:
        for name in ("arw", "rrw", "bias", "bias_sigma", "markov_sigma", "scale"):
            field = f"gyro.{name}"
            values = three(getattr(self, name), field)
            if name not in ("bias", "scale") and min(values) < 0.0:
                raise InputError("must not be negative", field=field, value=values)
            object.__setattr__(self, name, tuple(values))
        time = float(array(self.markov_time, "gyro.markov_time", ()))
        if not time > 0.0:
            raise InputError(
                "must be positive; infinite for a constant drift",
                field="gyro.markov_time",
                value=time,
            )
        step = number(self.quantisation, "gyro.quantisation", at_least=0.0)
        object.__setattr__(self, "markov_time", time)
        object.__setattr__(self, "quantisation", step)
        object.__setattr__(self, "misalignment", _misalignment(self.misalignment))
        object.__setattr__(self, "mounting", mounting(self.mounting, "gyro.mounting"))

    @property
    def response(self) -> FloatArray:
        """``I + M`` (3, 3): what the gyro reads of a rate in its frame, without bias and noise."""
        scale = np.diag(np.asarray(self.scale, dtype=np.float64))
        return np.asarray(np.eye(3) + scale + np.asarray(self.misalignment, dtype=np.float64))

    def _described(self) -> dict[str, Any]:
        names = ("arw", "rrw", "bias", "bias_sigma", "markov_sigma", "markov_time")
        return {
            **{name: getattr(self, name) for name in names},
            "response": self.response.tolist(),
            "quantisation": self.quantisation,
            "mounting": self.mounting,
        }


def _misalignment(value: ArrayLike) -> tuple[Three, Three, Three]:
    given = array(value, "gyro.misalignment")
    if given.shape not in ((6,), (3, 3)):
        raise InputError(
            f"has shape {given.shape}, needed are 6 numbers (xy, xz, yx, yz, zx, zy) or (3, 3)",
            field="gyro.misalignment",
        )
    if not np.isfinite(given).all():
        raise InputError("must be finite", field="gyro.misalignment", value=given)
    matrix = given
    if given.shape == (6,):
        matrix = np.zeros((3, 3))
        matrix[[0, 0, 1, 1, 2, 2], [1, 2, 0, 2, 0, 1]] = given
    return cast("tuple[Three, Three, Three]", tuple(tuple(row) for row in matrix.tolist()))


@dataclass(frozen=True)
class StarErrors:
    """Noise and times of a star camera that reports quaternions.

    A fix is ``q_ic * exp(e)``, with ``e`` normal of the full covariance, in the camera frame.

    Parameters
    ----------
    sigma : float or array_like (3,), optional
        1-sigma noise about the camera's axes [rad].
    covariance : array_like (3, 3), optional
        Noise covariance in the camera frame [rad^2], symmetric positive definite, instead.
    period : float, optional
        Time from fix to fix [s].
    every : int, optional
        One fix every so many samples of the truth instead; 1 if neither is given.
    offset : float
        Where the first fix lies after the start: [s] with `period`, samples with `every`.
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bc``, scalar first, camera frame to body.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore.units import ARCSEC
    >>> from celestcore.simulate import StarErrors
    >>> StarErrors([5 * ARCSEC, 5 * ARCSEC, 30 * ARCSEC], period=0.2).every is None
    True
    """

    sigma: ArrayLike | None = None
    _: KW_ONLY
    covariance: ArrayLike | None = None
    period: float | None = None
    every: int | None = None
    offset: float = 0.0
    mounting: QuaternionLike | None = None

    def __post_init__(self) -> None:
        known = StarCamera(self.sigma, covariance=self.covariance, mounting=self.mounting)
        if known.sigma is None and known.covariance is None:
            raise InputError("is needed [rad], or covariance", field="star.sigma")
        values = {"sigma": known.sigma, "covariance": known.covariance, "mounting": known.mounting}
        values |= schedule(self.period, self.every, self.offset)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @property
    def camera(self) -> StarCamera:
        """The `StarCamera` that knows this noise and mounting."""
        return StarCamera(self.sigma, covariance=self.covariance, mounting=self.mounting)

    def _covariance(self) -> FloatArray:
        """Noise covariance in the camera frame (3, 3) [rad^2]."""
        if self.covariance is not None:
            return np.asarray(self.covariance, dtype=np.float64)
        sigma = np.broadcast_to(np.asarray(self.sigma, dtype=np.float64), (3,))
        return np.diag(sigma * sigma)

    def _described(self, name: str, truth: Truth) -> tuple[Any, ...]:
        t, q = frames(self, truth)
        root = np.linalg.cholesky(self._covariance())
        return t, q, self.mounting, root.tolist()


class Scheduled(Protocol):
    """What says when a camera takes its frames."""

    @property
    def period(self) -> float | None: ...
    @property
    def every(self) -> int | None: ...
    @property
    def offset(self) -> float: ...


def schedule(period: float | None, every: int | None, offset: float) -> dict[str, Any]:
    """Return the times of a camera's frames, checked."""
    if period is not None and every is not None:
        raise InputError("goes without every: give one of them", field="star.period")
    first = number(offset, "star.offset", at_least=0.0)
    if period is not None:
        period = number(period, "star.period", above=0.0)
    else:
        every = 1 if every is None else count(every, "star.every")
        if first != np.floor(first):
            raise InputError(
                "is a number of samples unless there is a period",
                field="star.offset",
                value=first,
            )
    return {"period": period, "every": every, "offset": first}


def frames(camera: Scheduled, truth: Truth) -> tuple[FloatArray, FloatArray]:
    """Return times (m,) and true attitudes ``q_ib`` (m, 4) of a camera's frames."""
    if camera.period is None:
        rows = slice(int(camera.offset), None, camera.every)
        t, q = truth.t[rows], truth.q[rows]
    else:
        span = float(truth.t[-1] - truth.t[0]) - camera.offset
        n = max(0, int(span / camera.period + 2.0))
        t, q = truth._snapped(truth.t[0] + camera.offset + np.arange(n) * camera.period)
    if len(t) == 0:
        raise InputError("lies after the truth's end", field="star.offset", value=camera.offset)
    return np.ascontiguousarray(t), np.ascontiguousarray(q)
