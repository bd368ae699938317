"""`StarGyroState`: the attitude filter, one sample at a time."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, TypeGuard, overload

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._arguments import Sigma0, count, covariance_of, one_quaternion, positive, three
from celestcore._check import FloatArray, array, covariances, directions, number
from celestcore.errors import InputError
from celestcore.sensors import VectorSensor
from celestcore.solution import StateAt

if TYPE_CHECKING:
    from celestcore.navigator import StarGyroNavigator
    from celestcore.quaternion import QuaternionLike

__all__ = ["StarGyroState"]


class StarGyroState(_core.AttitudeStream):
    """A filter that is fed sample by sample: what `StarGyroNavigator.start` returns.

    Samples come in order of time: `predict` with each gyro sample or `process` with a block of
    them, `update` with each star fix, `update_direction` with each direction. The result is that of
    `StarGyroNavigator.run` on the same samples, except where a measurement falls between two gyro
    samples and the gyro's sampling is "integrated" or "average": the sample that ends the interval
    is then not known yet, and the last one is held. Without `Gyro.max_gap` no step is a gap: a
    stream knows no median step.

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
    noise_scale : dict of str to float
        What each sensor's noise (variance) is multiplied by, if the navigator is adaptive.
    lag : float or None
        How far `smoothed` goes back [s].

    Examples
    --------
    >>> import celestcore as cc
    >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
    >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
    >>> state.predict(0.0, [0.0, 0.0, 0.01])
    >>> state.predict(0.5, [0.0, 0.0, 0.01])
    >>> state.t, cc.quaternion.log(state.q).round(6)
    (0.5, array([0.   , 0.   , 0.005]))
    """

    navigator: StarGyroNavigator
    lag: float | None
    _numbers: dict[str, int]
    """Sensors in order of their first measurement: the core knows numbers."""

    def __new__(
        cls,
        navigator: StarGyroNavigator,
        t: float,
        q: Sequence[float],
        bias: ArrayLike,
        sigma0: Sigma0 | None,
        covariance0: ArrayLike | None = None,
        lag: float | None = None,
    ) -> StarGyroState:
        """Make the core's state."""
        gap = navigator.gyro.max_gap
        setup = navigator._setup(np.inf if gap is None else gap)
        turn = navigator.gyro._turn()
        to_body = None if turn is None else turn.reshape(-1).tolist()
        self = super().__new__(
            cls,
            setup,
            to_body,
            t,
            q,
            three(bias, "bias"),
            covariance_of(sigma0, covariance0),
            None if lag is None else number(lag, "lag", above=0.0),
        )
        self.navigator = navigator
        self.lag = lag
        self._numbers = {}
        return self

    @overload
    def process(
        self,
        rates: ArrayLike,
        dt: ArrayLike | None = None,
        *,
        t: ArrayLike | None = None,
        every: None = None,
        covariance: bool = False,
    ) -> None: ...
    @overload
    def process(
        self,
        rates: ArrayLike,
        dt: ArrayLike | None = None,
        *,
        t: ArrayLike | None = None,
        every: int,
        covariance: bool = False,
    ) -> StateAt: ...
    def process(
        self,
        rates: ArrayLike,
        dt: ArrayLike | None = None,
        *,
        t: ArrayLike | None = None,
        every: int | None = None,
        covariance: bool = False,
    ) -> StateAt | None:
        """Move on with a block of gyro samples: `predict` with each of them, in one call.

        The same bits as calls of `predict` at the times ``state.t + dt``, ``... + dt`` and so on.
        All of the block is used or, if an error is raised, nothing of it. Other Python threads run
        while a large block (512 samples or more) is worked on.

        Parameters
        ----------
        rates : array_like (n, 3)
            Measured rates, gyro frame [rad/s]. A C-ordered float64 array is not copied.
        dt : float or array_like (n,), optional
            Time from each sample to the one before it, of the first to the state's time [s].
        t : array_like (n,), optional
            Times of the samples instead [s], increasing; the first may be the state's own.
        every : int, optional
            Return the state after every so many samples of the block.
        covariance : bool
            Whether with full 6x6 covariances.

        Returns
        -------
        StateAt or None
            With `every`: columns of ``n // every`` rows.

        Raises
        ------
        InputError
            A rate that is not finite, a time that does not come after the one before it, a step
            that is not positive: names field, row and value. The state is as it was.
        NumericalError
            A covariance that is not positive definite; the state is as it was.
        KeyboardInterrupt
            On Ctrl-C, within a fraction of a second; the state is as it was.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
        >>> state.process([[0.0, 0.0, 0.01]] * 100, 0.5)
        >>> state.t, cc.quaternion.log(state.q).round(6)
        (50.0, array([0. , 0. , 0.5]))
        >>> rows = state.process([[0.0, 0.0, 0.01]] * 100, 0.5, every=50)
        >>> rows.t, rows.sigma.shape
        (array([ 75., 100.]), (2, 6))
        """
        if (dt is None) == (t is None):
            raise InputError("give steps dt or times t: one of them", field="dt")
        step = dt if isinstance(dt, float) else 0.0
        steps = None if dt is None or isinstance(dt, float) else array(dt, "dt")
        if steps is not None and steps.ndim == 0:
            step = float(steps)
            steps = None
        out = self._process(
            rates if _as_the_core_takes_it(rates) else array(rates, "rates", (None, 3)),
            None if t is None else array(t, "t", (None,)),
            None if steps is None else array(steps, "dt", (None,)),
            step,
            None if every is None else count(every, "every"),
            bool(covariance),
        )
        if out is not None and not covariance:
            out["covariance"] = None
        return None if out is None else StateAt(**out)

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

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
        >>> used = state.update(0.0, [1.0, 1e-4, 0.0, 0.0])
        >>> used.accepted, used.dof, used.innovation.round(6)
        (True, 3, array([0.0002, 0.    , 0.    ]))
        """
        own = self.navigator._camera(camera)
        each = None if sigma is None else np.reshape(positive(sigma, "sigma"), (1, 3))
        full = None
        if covariance is not None:
            full = array(covariance, "covariance", (3, 3))[None]
            full = covariances(full, "covariance", 1, one=True)
        q_ib, noise = own.to_body(np.reshape(one_quaternion(q, "q"), (1, 4)), each, full)
        seen = self._number(camera)
        return self.update_star(number(t, "t"), q_ib[0].tolist(), noise[0].tolist(), seen)

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

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
        >>> used = state.update_direction(0.0, [0.0, 0.0, 1.0], [0.0, 1e-4, 1.0], sigma=1e-3)
        >>> used.accepted, used.dof
        (True, 2)
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
        seen = self._number(f"vector_{sensor or ''}")
        return self.update_vector(number(t, "t"), b.tolist(), i.tolist(), noise, seen)

    def _number(self, name: str) -> int:
        """Return a sensor's number; all are one where their noise is not found."""
        if self.navigator.adaptive is None:
            return 0
        return self._numbers.setdefault(name, len(self._numbers))

    def smoothed(self) -> StateAt:
        """Return the states of the last `lag` seconds, each knowing all measurements up to now.

        The first row is the fixed-lag estimate: the latest state that is at least `lag` old (the
        oldest there is, as long as the state is younger). The last row is the present.

        Returns
        -------
        StateAt
            With a leading axis over the steps of the lag, oldest first. `rate` is NaN in the last
            row, whose step has not been made.

        Raises
        ------
        InputError
            If the state was started without a lag.
        NumericalError
            A covariance that is not positive definite.

        Notes
        -----
        Rauch-Tung-Striebel over the lag at each call: some 2 microseconds a step. Call it when an
        estimate is wanted, not with every sample.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0], lag=5.0)
        >>> for k in range(101):
        ...     state.predict(0.1 * k, [0.0, 0.0, 0.0])
        ...     used = state.update(0.1 * k, [1.0, 0.0, 0.0, 0.0])
        >>> late = state.smoothed()
        >>> round(float(late.t[0]), 6), bool(late.sigma[0, 0] < state.sigma[0])
        (5.0, True)
        """
        t, q, bias, covariance = self._smoothed()
        rate = np.full((len(t), 3), np.nan)
        past = self._snapshot()[6]
        rate[:-1] = past[:, 2:5] - bias[:-1]
        sigma = np.sqrt(np.diagonal(covariance, axis1=1, axis2=2))
        return StateAt(t=t, q=q, rate=rate, bias=bias, sigma=sigma, covariance=covariance)

    @property
    def noise_scale(self) -> dict[str, float]:
        """What each sensor's variance is multiplied by, as far as an adaptive navigator knows."""
        return {name: self._noise_scale()[number] for name, number in self._numbers.items()}

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
        """Return a copy that goes its own way.

        Returns
        -------
        StarGyroState

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-9), cc.StarCamera(1e-5))
        >>> state = nav.start(t=0.0, q=[1.0, 0.0, 0.0, 0.0])
        >>> ahead = state.copy()
        >>> ahead.predict(60.0, [0.0, 0.0, 0.01])
        >>> state.t
        0.0
        """
        return copy.copy(self)

    def __reduce__(self) -> tuple[Any, ...]:
        own = {**self.__dict__, "_numbers": dict(self._numbers)}
        return _restore, (type(self), self.navigator, self._snapshot(), self.lag), own

    def __repr__(self) -> str:
        sigma = ", ".join(f"{s:.3g}" for s in self.sigma)
        return f"StarGyroState(t={self.t:.10g}, q={self.q.round(9).tolist()}, sigma=[{sigma}])"


def _as_the_core_takes_it(rates: ArrayLike) -> TypeGuard[FloatArray]:
    """Tell whether an array of rates can be read where it is."""
    return (
        type(rates) is np.ndarray
        and rates.dtype == np.float64
        and rates.shape[1:] == (3,)
        and rates.flags.c_contiguous
        and rates.flags.aligned
    )


def _restore(
    cls: type[StarGyroState],
    navigator: StarGyroNavigator,
    parts: tuple[Any, ...],
    lag: float | None,
) -> StarGyroState:
    state = StarGyroState.__new__(cls, navigator, parts[0], parts[1], parts[2], (1.0, 1.0), lag=lag)
    state._restore(parts)
    return state
