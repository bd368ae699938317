"""Sensors: their noise and how they are mounted on the spacecraft.

A mounting quaternion ``q_bs`` takes vectors of the sensor's frame to the body frame. `frame` names
the body frame that it leads to; sensors that are used together must name the same one.
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any, TypeAlias, cast

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import (
    FloatArray,
    array,
    covariances,
    directions,
    mounting,
    number,
    quaternion,
    unit_rows,
    warn,
)
from celestcore._tables import warn_if_large
from celestcore.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

QuaternionLike: TypeAlias = "ArrayLike | Rotation"

__all__ = ["SAMPLINGS", "Gyro", "StarCamera", "VectorSensor"]

SAMPLINGS = ("hold", "integrated", "average")
_LARGE_ARW = 1e-2
_LARGE_ERRORS = 0.5
_PACKED = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def _set(sensor: object, **values: Any) -> None:
    for name, value in values.items():
        object.__setattr__(sensor, name, value)


def _frame(value: object, field: str) -> str:
    if not isinstance(value, str) or not value.strip():
        raise InputError("must be the name of a frame", field=field, value=value)
    return value


def _matrix(q: QuaternionLike) -> FloatArray:
    from celestcore.quaternion import to_matrix

    return np.asarray(to_matrix(np.asarray(q, dtype=np.float64)))


def _turned(turn: FloatArray, v: FloatArray) -> FloatArray:
    """Return vectors (..., 3) turned by a matrix, to the bits of the core.

    Term by term as there: a matrix product may round differently.
    """
    x, y, z = (turn[:, k] * v[..., k : k + 1] for k in range(3))
    return np.ascontiguousarray(x + y + z)


@lru_cache(maxsize=64)
def _packed_rotation(mounting: tuple[float, ...] | None) -> FloatArray:
    """Return the matrix (9, 6) from the elements of C to those of R C R^T, packed."""
    turn = np.eye(3) if mounting is None else _matrix(mounting)
    return np.stack([np.outer(turn[i], turn[j]).reshape(9) for i, j in _PACKED], axis=1)


@dataclass(frozen=True)
class Gyro:
    """A rate gyro with three axes.

    Parameters
    ----------
    arw : float
        Angle random walk [rad/sqrt(s)], positive.
    rrw : float
        Rate random walk of the bias [rad/s/sqrt(s)].
    sampling : {"hold", "integrated", "average"}
        What sample k means: ``"hold"``: the rate from t_k to t_{k+1}; ``"integrated"``: the mean
        rate from t_{k-1} to t_k; ``"average"``: the rate at t_k, the mean of both ends is used.
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bg``, scalar first, gyro frame to body.
    errors : array_like (3, 3), optional
        Scale factors (diagonal) and misalignments M in ``rate_measured = (I + M) rate + bias``, in
        the body frame; they are taken out. See `StarGyroNavigator.calibrate`.
    frame : str
        The name of the body frame.
    max_gap : float, optional
        Longest step [s] that is no gap; None: three times the log's median step.
    gap_rate_sigma : float
        1-sigma uncertainty of the mean rate inside a gap [rad/s]; it grows the covariance.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore.units import DEG_PER_SQRT_HOUR
    >>> Gyro(arw=0.001 * DEG_PER_SQRT_HOUR, rrw=3e-9).sampling
    'hold'
    """

    arw: float
    rrw: float = 0.0
    _: KW_ONLY
    sampling: str = "hold"
    mounting: QuaternionLike | None = None
    errors: ArrayLike | None = None
    frame: str = "body"
    max_gap: float | None = None
    gap_rate_sigma: float = 1e-3

    def __post_init__(self) -> None:
        if self.sampling not in SAMPLINGS:
            raise InputError(
                f"must be one of {', '.join(SAMPLINGS)}", field="gyro.sampling", value=self.sampling
            )
        gap = self.max_gap
        _set(
            self,
            arw=number(self.arw, "gyro.arw", above=0.0),
            rrw=number(self.rrw, "gyro.rrw", at_least=0.0),
            mounting=mounting(self.mounting, "gyro.mounting"),
            errors=None if self.errors is None else _errors(self.errors),
            frame=_frame(self.frame, "gyro.frame"),
            max_gap=None if gap is None else number(gap, "gyro.max_gap", above=0.0),
            gap_rate_sigma=number(self.gap_rate_sigma, "gyro.gap_rate_sigma", at_least=0.0),
        )
        if self.arw > _LARGE_ARW:
            warn(
                f"gyro.arw is {self.arw:.4g} rad/sqrt(s): if it is in degrees per square root of "
                "an hour, multiply by celestcore.DEG_PER_SQRT_HOUR"
            )

    def to_body(self, rate: ArrayLike) -> FloatArray:
        """Return rates of the gyro frame in the body frame, its errors taken out.

        Without a mounting and errors the array itself comes back.

        Parameters
        ----------
        rate : array_like (n, 3)
            Measured rates, gyro frame [rad/s].

        Returns
        -------
        ndarray (n, 3)
            Rates, body frame [rad/s]; the bias is still in them.

        Examples
        --------
        >>> Gyro(arw=1e-6, mounting=[0.0, 1.0, 0.0, 0.0]).to_body([[1.0, 2.0, 3.0]])
        array([[ 1., -2., -3.]])
        """
        rate = np.ascontiguousarray(rate, dtype=np.float64)
        turn = self._turn()
        if turn is None:
            return rate
        return _turned(turn, rate)

    def _turn(self) -> FloatArray | None:
        """Matrix (3, 3) from measured rates to rates of the body, None for none."""
        if self.mounting is None and self.errors is None:
            return None
        turn = np.eye(3) if self.mounting is None else _matrix(self.mounting)
        if self.errors is None:
            return turn
        return np.asarray(np.linalg.solve(np.eye(3) + np.asarray(self.errors), turn))


def _errors(value: ArrayLike) -> tuple[tuple[float, ...], ...]:
    m = array(value, "gyro.errors", (3, 3))
    if not np.isfinite(m).all():
        bad = float(m[~np.isfinite(m)][0])
        raise InputError("must be finite", field="gyro.errors", value=bad)
    size = float(np.linalg.norm(m))
    if not size < _LARGE_ERRORS:
        raise InputError(
            "must be small beside 1: scale factors and misalignments, not the whole matrix",
            field="gyro.errors",
            value=size,
        )
    return tuple(tuple(row) for row in m.tolist())


@dataclass(frozen=True)
class StarCamera:
    """A star camera that measures a full attitude quaternion.

    Parameters
    ----------
    sigma : float or array_like (3,), optional
        1-sigma noise about the camera's axes [rad]; used for fixes that bring no own noise.
    covariance : array_like (3, 3), optional
        Noise covariance in the camera frame [rad^2], symmetric positive definite, instead.
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bc``, scalar first, camera frame to body. None: the fixes are body to inertial already.
    frame : str
        The name of the body frame.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore.units import ARCSEC
    >>> StarCamera(5 * ARCSEC).mounting is None
    True
    """

    sigma: ArrayLike | None = None
    _: KW_ONLY
    covariance: ArrayLike | None = None
    mounting: QuaternionLike | None = None
    frame: str = "body"

    def __post_init__(self) -> None:
        if self.sigma is not None and self.covariance is not None:
            raise InputError("give sigma or covariance, not both", field="star")
        if self.sigma is not None:
            _set(self, sigma=_star_sigma(self.sigma))
        if self.covariance is not None:
            c = array(self.covariance, "star.covariance", (3, 3))
            c = covariances(c[None], "star.covariance", 1, one=True)
            _set(self, covariance=tuple(tuple(row) for row in c[0].tolist()))
        _set(
            self,
            mounting=mounting(self.mounting, "star.mounting"),
            frame=_frame(self.frame, "star.frame"),
        )

    def to_body(
        self,
        q: QuaternionLike,
        sigma: ArrayLike | None = None,
        covariance: ArrayLike | None = None,
    ) -> tuple[FloatArray, FloatArray]:
        """Turn fixes of the camera into fixes of the body.

        Parameters
        ----------
        q : array_like (n, 4)
            ``q_ic``, scalar first, camera to inertial.
        sigma : array_like (n, 3), optional
            Noise of each fix [rad], camera frame; goes before the camera's own.
        covariance : array_like (n, 3, 3), optional
            Noise covariance of each fix [rad^2], camera frame; goes before all others.

        Returns
        -------
        q_ib : ndarray (n, 4)
            Body to inertial, unit, scalar first.
        noise : ndarray (n, 6)
            Covariance in the body frame [rad^2], packed xx, xy, xz, yy, yz, zz.

        Raises
        ------
        InputError
            If neither the fixes nor the camera have noise.

        Examples
        --------
        >>> camera = StarCamera([1e-5, 1e-5, 1e-4], mounting=[0.0, 1.0, 0.0, 0.0])
        >>> q_ib, noise = camera.to_body([[0.0, 1.0, 0.0, 0.0]])
        >>> abs(q_ib[0]).round(6), noise.shape
        (array([1., 0., 0., 0.]), (1, 6))
        """
        q_ic = quaternion(q, "star.q")
        with np.errstate(all="ignore"):  # the core refuses noise that is not finite
            noise = self._noise(len(q_ic), sigma, covariance)
        if self.mounting is None:
            q_ib = q_ic
        else:
            from celestcore.quaternion import conjugate, multiply

            q_bc = np.asarray(self.mounting, dtype=np.float64)
            q_ib = np.ascontiguousarray(multiply(q_ic, conjugate(q_bc)))
        return q_ib, np.array(np.broadcast_to(noise, (len(q_ic), 6)), order="C")

    def _noise(self, n: int, sigma: ArrayLike | None, covariance: ArrayLike | None) -> FloatArray:
        """Noise in the body frame, packed (n, 6); (1, 6) if always the same."""
        variances = self._covariance(n, sigma, covariance).reshape(-1, 9)
        stored = cast("tuple[float, ...] | None", self.mounting)  # since __post_init__
        turn = _packed_rotation(stored)
        if sigma is None and covariance is None:
            return np.asarray(variances @ turn)
        # term by term, as the core does it for the fixes of a log
        noise = variances[:, :1] * turn[0]
        for k in range(1, 9):
            noise += variances[:, k : k + 1] * turn[k]
        return np.asarray(noise)

    def _noise_for_core(self, own: FloatArray | None) -> FloatArray:
        """Noise as the core takes it: of each fix if they bring their own, else (6,) for all."""
        if own is not None:
            return own
        with np.errstate(all="ignore"):  # the core refuses noise that is not finite
            return np.ascontiguousarray(self._noise(1, None, None)[0])

    def _covariance(
        self, n: int, sigma: ArrayLike | None, covariance: ArrayLike | None
    ) -> FloatArray:
        """Noise covariance in the camera frame, (n, 3, 3); (1, 3, 3) if always the same."""
        if covariance is not None:
            return array(covariance, "star.covariance", (n, 3, 3))
        if sigma is not None:
            return _diagonal(array(sigma, "star.sigma", (n, 3)))
        if self.covariance is not None:
            return np.asarray(self.covariance, dtype=np.float64).reshape(1, 3, 3)
        if self.sigma is not None:
            own = np.asarray(self.sigma, dtype=np.float64)
            return _diagonal(np.broadcast_to(own, (1, 3)))
        raise InputError(
            "the camera has no noise and the fixes bring none; give StarCamera(sigma=...) in rad",
            field="star.sigma",
        )


def _star_sigma(value: ArrayLike) -> float | tuple[float, ...]:
    sigma = array(value, "star.sigma")
    if sigma.shape not in ((), (1,), (3,)):
        raise InputError(
            f"must be one number or three, got shape {sigma.shape}", field="star.sigma"
        )
    values = [number(s, "star.sigma", above=0.0) for s in sigma.reshape(-1)]
    warn_if_large(sigma, "star.sigma")
    return values[0] if len(values) == 1 else tuple(values)


def _diagonal(sigma: FloatArray) -> FloatArray:
    out = np.zeros((len(sigma), 3, 3))
    out[:, [0, 1, 2], [0, 1, 2]] = sigma * sigma
    return out


@dataclass(frozen=True)
class VectorSensor:
    """A sensor of one direction known in inertial space: a star, the Sun, the magnetic field.

    Parameters
    ----------
    sigma : float
        1-sigma noise of the direction about each axis across it [rad].
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bs``, scalar first, sensor frame to body.
    frame : str
        The name of the body frame.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore.units import DEG
    >>> VectorSensor(0.5 * DEG).to_body([[0.0, 0.0, 2.0]])
    array([[0., 0., 1.]])
    """

    sigma: float
    _: KW_ONLY
    mounting: QuaternionLike | None = None
    frame: str = "body"

    def __post_init__(self) -> None:
        sigma = number(self.sigma, "vector.sigma", above=0.0)
        _set(
            self,
            sigma=sigma,
            mounting=mounting(self.mounting, "vector.mounting"),
            frame=_frame(self.frame, "vector.frame"),
        )
        warn_if_large(np.array([sigma]), "vector.sigma")

    def to_body(self, b: ArrayLike) -> FloatArray:
        """Return directions of the sensor frame as unit vectors of the body frame.

        Parameters
        ----------
        b : array_like (n, 3)
            Measured directions, sensor frame, of any length.

        Returns
        -------
        ndarray (n, 3)
            Unit vectors, body frame.

        Raises
        ------
        InputError
            Names the row of a vector without direction.

        Examples
        --------
        >>> VectorSensor(0.01, mounting=[0.0, 1.0, 0.0, 0.0]).to_body([[0.0, 0.0, 2.0]])
        array([[ 0.,  0., -1.]])
        """
        v = directions(array(b, "vector.body", (None, 3)), "vector.body")
        if self.mounting is not None:
            v = _turned(_matrix(self.mounting), v)
        v /= np.linalg.norm(v, axis=1, keepdims=True)
        return unit_rows(v, "vector.body", what="vector", hint="")

    def _turn(self) -> list[float]:
        """Matrix from the sensor's frame to the body's, row by row."""
        turn = np.eye(3) if self.mounting is None else _matrix(self.mounting)
        entries: list[float] = turn.reshape(-1).tolist()
        return entries
