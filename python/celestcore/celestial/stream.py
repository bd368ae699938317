"""`CelestialState`: an orbit estimated epoch by epoch."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import _core
from celestcore._check import FloatArray, array, number, unit_rows

if TYPE_CHECKING:
    from celestcore.celestial.navigator import CelestialNavigator

__all__ = ["CelestialState"]


class CelestialState(_core.OrbitStream):
    """A filter that is fed epoch by epoch: what `CelestialNavigator.start` returns.

    `predict` moves it on in time, `update_horizon` and `update_refraction` correct it at its own
    time. The result is that of `CelestialNavigator.run` on the same epochs. A call that raises
    leaves it as it was.

    Attributes
    ----------
    t : float
        Time of the state [s].
    r, v : ndarray (3,)
        Position [m] and velocity [m/s], GCRS.
    sigma : ndarray (6,)
        Their 1-sigma.
    covariance : ndarray (6, 6)

    Examples
    --------
    >>> import celestcore as cc
    >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
    >>> nav = cc.CelestialNavigator(cc.UKF(), dynamics, cc.StarHorizon())
    >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3])
    >>> state.predict(3.0)
    >>> state.update_horizon([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0]], [1.574, 1.571]).accepted
    True
    """

    navigator: CelestialNavigator
    _tables: dict[str, Any] | None
    _epoch: Any

    def __new__(
        cls,
        navigator: CelestialNavigator,
        t: float,
        state: list[float],
        covariance: FloatArray,
        tables: dict[str, Any] | None,
        epoch: Any = None,
    ) -> CelestialState:
        """Make the core's state."""
        self = super().__new__(cls, navigator._described(tables, epoch, t), t, state, covariance)
        self.navigator = navigator
        self._tables = tables
        self._epoch = epoch
        return self

    @property
    def r(self) -> FloatArray:
        """Position [m], GCRS."""
        return np.ascontiguousarray(self.state[:3])

    @property
    def v(self) -> FloatArray:
        """Velocity [m/s], GCRS."""
        return np.ascontiguousarray(self.state[3:])

    @property
    def sigma(self) -> FloatArray:
        """1-sigma of position [m] and velocity [m/s]."""
        return np.sqrt(np.diag(self.covariance))

    def predict(self, t: float) -> None:
        """Move on in time.

        Parameters
        ----------
        t : float
            To this time [s], not before the state's.

        Raises
        ------
        InputError
            If the time lies before the state's.
        NumericalError
            If the covariance breaks down.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3])
        >>> state.predict(60.0)
        >>> state.t
        60.0
        """
        super().predict(number(t, "t"))

    def update_horizon(self, star: ArrayLike, angle: ArrayLike) -> _core.Update:
        """Correct by the angles of one epoch between stars and the nadir.

        Parameters
        ----------
        star : array_like (k, 3)
            Unit vectors to the stars, GCRS.
        angle : array_like (k,)
            Angles [rad].

        Returns
        -------
        Update
            With ``accepted``, ``nis``, ``dof``, ``innovation`` and its ``covariance``.

        Raises
        ------
        InputError
            A star that is no unit vector, an angle outside 0 to pi.
        NumericalError
            If the covariance breaks down.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3])
        >>> state.update_horizon([[0.0, 0.0, 1.0]], [1.5708]).dof
        1
        """
        return super().update_horizon(*_angles(star, angle))

    def update_refraction(self, star: ArrayLike, angle: ArrayLike) -> _core.Update:
        """Correct by refraction angles of stars seen through the atmosphere.

        Parameters
        ----------
        star : array_like (k, 3)
            Unit vectors to the stars without refraction, GCRS.
        angle : array_like (k,)
            Refraction angles [rad].

        Returns
        -------
        Update
            With ``accepted``, ``nis`` and ``dof``.

        Raises
        ------
        InputError
            A star that is no unit vector; a navigator without `StarRefraction`.
        NumericalError
            If the covariance breaks down.

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarRefraction())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3])
        >>> state.update_refraction([[-0.40, 0.0, 0.9165]], [3e-4]).dof
        1
        """
        return super().update_refraction(*_angles(star, angle))

    def copy(self) -> CelestialState:
        """Return an independent copy.

        Returns
        -------
        CelestialState

        Examples
        --------
        >>> import celestcore as cc
        >>> dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=4e-7)
        >>> nav = cc.CelestialNavigator(cc.EKF(), dynamics, cc.StarHorizon())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3])
        >>> other = state.copy()
        >>> other.predict(10.0)
        >>> state.t, other.t
        (0.0, 10.0)
        """
        return CelestialState(
            self.navigator, self.t, self.state.tolist(), self.covariance, self._tables, self._epoch
        )


def _angles(star: ArrayLike, angle: ArrayLike) -> tuple[FloatArray, FloatArray]:
    angles = array(angle, "angle", (None,))
    stars = array(star, "star", (len(angles), 3))
    unit_rows(stars, "star", what="vector", hint="normalise it")
    return stars, angles
