"""A GNSS and star navigator that is fed one measurement at a time."""

from __future__ import annotations

import copy
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from celestcore import quaternion
from celestcore._arguments import one_quaternion
from celestcore._check import FloatArray, array, number
from celestcore._epoch import epoch_string
from celestcore._replay import BIAS_SIGMA
from celestcore.elements import from_state
from celestcore.elements import period as orbit_period
from celestcore.errors import InputError
from celestcore.frames import orbital
from celestcore.gnss._earth import Earth
from celestcore.gnss._orbit import turned
from celestcore.gnss._run import covariance_of
from celestcore.orbit.propagate import environment_of, position, vector, velocity

if TYPE_CHECKING:
    from celestcore.gnss.navigator import GnssStarNavigator

__all__ = ["FixReport", "GnssStarState"]


class FixReport(NamedTuple):
    """What a filter made of a measurement.

    Attributes
    ----------
    accepted : bool
    nis : float
        Normalised innovation squared, of a fix with a velocity the sum of both.
    dof : int
    innovation : ndarray (3,)
        Of the position [m], GCRS, or of the attitude [rad], body axes.

    Examples
    --------
    >>> FixReport(True, 2.0, 3, np.zeros(3)).accepted
    True
    """

    accepted: bool
    nis: float
    dof: int
    innovation: FloatArray


class _Filter:
    """One of the two filters: a time, a state and a covariance that a core moves on."""

    def __init__(self, core: Any, t: float, state: FloatArray, covariance: FloatArray) -> None:
        self.core, self.t, self.state, self.covariance = core, t, state, covariance

    def step(
        self, stops: list[float], gyro: FloatArray | None, fixes: tuple[Any, ...], gate: float
    ) -> dict[str, Any]:
        wanted = np.zeros(len(stops), bool)
        start = (self.t, self.state, self.covariance)
        out: dict[str, Any] = self.core.run(
            (np.array(stops), wanted, gyro), fixes, start, gate, False, False, False, None
        )
        size = self.covariance.shape
        self.t, self.state = out["final_t"], out["final_state"]
        self.covariance = out["final_covariance"].reshape(size)
        return out


LOW = 2e7
"""Distance from the Earth's centre [m] below which an Earth-fixed velocity is above 1 km/s."""
NO_ORBIT_FIX = (np.empty(0), np.empty(0, bool), np.empty((0, 3)), np.empty((0, 6)))


class GnssStarState:
    """Orbit and attitude that follow measurements as they come; made by `GnssStarNavigator.start`.

    Examples
    --------
    >>> import celestcore as cc
    >>> nav = cc.GnssStarNavigator(cc.EKF(), cc.orbit.ForceModel.j2())
    >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], epoch="2026-01-01")
    >>> state.predict(60.0)
    >>> state.t, state.r.shape
    (60.0, (3,))
    """

    def __init__(self, nav: GnssStarNavigator, epoch: str, orbit: _Filter, sigma_q: float) -> None:
        self.navigator = nav
        self.epoch = epoch
        self._orbit = orbit
        self._attitude: _Filter | None = None
        self._sigma_q = sigma_q
        self._rate: FloatArray | None = None

    @property
    def t(self) -> float:
        """Time [s since the epoch]."""
        return self._orbit.t

    @property
    def r(self) -> FloatArray:
        """Position [m], GCRS (3,)."""
        return np.array(self._orbit.state[:3])

    @property
    def v(self) -> FloatArray:
        """Velocity [m/s], GCRS (3,)."""
        return np.array(self._orbit.state[3:6])

    @property
    def orbit_covariance(self) -> FloatArray:
        """Covariance of position and velocity, and of the receiver's bias."""
        return np.array(self._orbit.covariance)

    @property
    def sigma(self) -> FloatArray:
        """1-sigma of position [m] and velocity [m/s] (6,)."""
        return np.asarray(np.sqrt(np.diag(self._orbit.covariance)[:6]))

    @property
    def q(self) -> FloatArray | None:
        """Attitude ``q_ib`` (4,), None before the first star fix."""
        if self._attitude is None:
            return None
        own: FloatArray = self._attitude.state[:4]
        if self.navigator.gyro is not None:
            return np.array(own)
        return quaternion.multiply(orbital(self.r, self.v), own)

    @property
    def sigma_q(self) -> FloatArray | None:
        """1-sigma of the attitude's error, body axes [rad] (3,)."""
        if self._attitude is None:
            return None
        return np.asarray(np.sqrt(np.diag(self._attitude.covariance)[:3]))

    def predict(self, t: float, rate: ArrayLike | None = None) -> None:
        """Move on in time.

        Parameters
        ----------
        t : float
            To this time [s], not before the state's.
        rate : array_like (3,), optional
            Mean measured rate of the gyro up to then, gyro frame [rad/s], of a navigator with a
            gyro; the last one is held unless given.

        Raises
        ------
        InputError
            If the time lies before the state's.
        NumericalError
            If a covariance breaks down; the state is as it was.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.GnssStarNavigator(cc.EKF(), cc.orbit.ForceModel.j2())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], epoch="2026-01-01")
        >>> state.predict(10.0)
        """
        to = number(t, "t")
        if to < self.t:
            raise InputError(f"lies before the state's own time, {self.t!r} s", field="t", value=to)
        if rate is not None:
            gyro = self.navigator.gyro
            if gyro is None:
                raise InputError("is given, but the navigator has no gyro", field="rate")
            self._rate = gyro.to_body(array(rate, "rate", (3,))[None])[0]
        if to == self.t:
            return
        before = copy.copy(self._orbit), copy.copy(self._attitude)
        try:
            begin = self.t
            self._orbit.step([begin, to], None, NO_ORBIT_FIX, 1.0)
            if self._attitude is not None:
                self._attitude.step([begin, to], self._gyro(2), self._no_fix(), 1.0)
        except BaseException:
            self._orbit, self._attitude = before
            raise

    def update_gnss(self, t: float, r_e: ArrayLike, v_e: ArrayLike | None = None) -> FixReport:
        """Correct the orbit by a fix of the receiver.

        Parameters
        ----------
        t : float
            Time tag of the fix [s]; the state moves on to it, less the receiver's time offset.
        r_e : array_like (3,)
            Position of the antenna, Earth-fixed [m].
        v_e : array_like (3,), optional
            Its velocity, Earth-fixed [m/s].

        Returns
        -------
        FixReport

        Raises
        ------
        InputError
            A time before the state's, kilometres for metres, a position inside the Earth, a lever
            arm without an attitude.
        NumericalError
            If the covariance breaks down.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.GnssStarNavigator(cc.EKF(), cc.orbit.ForceModel.j2())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], epoch="2026-01-01")
        >>> r_e, v_e = cc.frames.to_itrs("2026-01-01", [0.0], [[7e6, 0, 0]], [[0, 0, 7.5e3]])
        >>> state.update_gnss(0.0, r_e[0], v_e[0]).dof
        6
        """
        receiver = self.navigator.gnss
        fixed = np.asarray(position(r_e, "r_e"))
        at = number(t, "t") - receiver.time_offset
        self.predict(at)
        matrices, turn = Earth(self.epoch).at(np.array([at]))
        r_ie = matrices[0]
        r = r_ie @ fixed
        rows = [(False, r, np.square(np.asarray(receiver.sigma)))]
        if v_e is not None and receiver.sigma_velocity is not None:
            # in a geostationary orbit an Earth-fixed velocity may be of any small size
            read = velocity if np.linalg.norm(fixed) < LOW else vector
            absolute = np.asarray(read(v_e, "v_e")) + np.cross(turn[0], fixed)
            rows.append((True, r_ie @ absolute, np.square(np.asarray(receiver.sigma_velocity))))
        arm = np.asarray(receiver.lever_arm)
        if arm.any():
            place, speed = self._lever(arm)
            rows = [(v, z - (speed if v else place), s) for v, z, s in rows]
        fixes = (
            np.full(len(rows), self.t),
            np.array([row[0] for row in rows]),
            np.array([row[1] for row in rows]),
            np.concatenate([turned(row[2], r_ie[None]) for row in rows]),
        )
        out = self._orbit.step([self.t], None, fixes, self.navigator.gate)
        return FixReport(
            bool(out["accepted"].all()),
            float(out["nis"].sum()),
            3 * len(rows),
            out["innovation"][0],
        )

    def update_star(
        self, t: float, q: ArrayLike, sigma: ArrayLike | None = None, *, camera: str = "star"
    ) -> FixReport:
        """Correct the attitude by a star fix.

        Parameters
        ----------
        t : float
            Time tag of the fix [s]; the state moves on to it, less the star sensor's time offset.
        q : array_like (4,)
            Camera to GCRS, scalar first, either sign.
        sigma : array_like (3,), optional
            1-sigma of this fix about the camera's axes [rad].
        camera : str
            Name of the star sensor, where the navigator knows several.

        Returns
        -------
        FixReport

        Raises
        ------
        InputError
            A time before the state's, no unit quaternion.
        NumericalError
            If the covariance breaks down.

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.GnssStarNavigator(cc.EKF(), cc.orbit.ForceModel.j2())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], epoch="2026-01-01")
        >>> state.update_star(0.0, [1.0, 0.0, 0.0, 0.0]).accepted
        True
        """
        nav = self.navigator
        row = np.array(one_quaternion(q, "q")).reshape(1, 4)
        noise = None if sigma is None else array(sigma, "sigma", (3,))[None]
        fix, packed = nav._camera(camera).to_body(row, noise)
        self.predict(number(t, "t") - nav.star_time_offset)
        if nav.gyro is None:
            fix = quaternion.multiply(quaternion.conjugate(orbital(self.r, self.v)), fix)
        if self._attitude is None:
            self._attitude = self._begin(fix[0])
        weights = np.zeros((1, 0))
        if nav.lfe is not None:
            weights = nav.lfe.weights(np.array([self.t]), self._period())
        fixes = (np.array([self.t]), np.ascontiguousarray(fix), packed, weights)
        out = self._attitude.step([self.t], self._gyro(1), fixes, nav.gate)
        return FixReport(bool(out["accepted"][0]), float(out["nis"][0]), 3, out["innovation"][0])

    def copy(self) -> GnssStarState:
        """Return an independent copy.

        Returns
        -------
        GnssStarState

        Examples
        --------
        >>> import celestcore as cc
        >>> nav = cc.GnssStarNavigator(cc.EKF(), cc.orbit.ForceModel.j2())
        >>> state = nav.start(0.0, [7e6, 0, 0], [0, 0, 7.5e3], epoch="2026-01-01")
        >>> other = state.copy()
        >>> other.predict(10.0)
        >>> state.t, other.t
        (0.0, 10.0)
        """
        other = copy.copy(self)
        other._orbit, other._attitude = copy.copy(self._orbit), copy.copy(self._attitude)
        return other

    def _period(self) -> float:
        lfe = self.navigator.lfe
        if lfe is not None and lfe.period is not None:
            return float(lfe.period)
        return float(orbit_period(from_state(self.r, self.v).a))

    def _gyro(self, stops: int) -> FloatArray | None:
        if self.navigator.gyro is None:
            return None
        if self._rate is None and stops == 1:
            return np.zeros((1, 4))  # no time passes
        if self._rate is None:
            raise InputError("is needed: the navigator has a gyro", field="rate")
        return np.ascontiguousarray(np.tile(np.append(self._rate, 0.0), (stops, 1)))

    def _no_fix(self) -> tuple[Any, ...]:
        lfe = self.navigator.lfe
        vectors = 0 if lfe is None else lfe.vectors
        return np.empty(0), np.empty((0, 4)), np.empty((0, 6)), np.empty((0, vectors))

    def _lever(self, arm: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Position and velocity of the antenna from the centre of mass, GCRS."""
        q = self.q
        if q is None or self._attitude is None:
            raise InputError(
                "needs an attitude: give a star fix, or q at the start, before the first GNSS fix",
                field="gnss.lever_arm",
            )
        if self.navigator.gyro is not None:
            rate = np.zeros(3) if self._rate is None else self._rate - self._attitude.state[4:7]
        else:
            h = np.cross(self.r, self.v)
            about = -np.linalg.norm(h) / np.dot(self.r, self.r)
            back = quaternion.conjugate(self._attitude.state[:4])
            rate = self._attitude.state[4:7] + quaternion.rotate(back, [0.0, about, 0.0])
        return quaternion.rotate(q, arm), quaternion.rotate(q, np.cross(rate, arm))

    def _begin(self, q: FloatArray) -> _Filter:
        """Start the attitude filter at an attitude, about the orbital frame or the GCRS."""
        nav = self.navigator
        if nav.gyro is not None:
            head, sigma = np.append(q, np.zeros(3)), np.repeat([self._sigma_q, BIAS_SIGMA], 3)
        else:
            own = nav.attitude
            head = np.append(q, np.zeros(6))
            sigma = np.repeat([self._sigma_q, own.rate_sigma, own.acceleration_sigma], 3)
        if nav.lfe is not None:
            head = np.append(head, np.zeros(3 * nav.lfe.vectors))
            sigma = np.append(sigma, np.repeat(nav.lfe.prior, 3))
        return _Filter(nav._attitude_core(), self.t, head, np.diag(sigma * sigma))


def begin(
    nav: GnssStarNavigator,
    t: float,
    state: tuple[ArrayLike, ArrayLike, ArrayLike | None],
    sigmas: tuple[Any, float],
    epoch: Any,
    until: float,
    environment: dict[str, Any] | None,
) -> GnssStarState:
    """Start filters; see `GnssStarNavigator.start`."""
    at, name = number(t, "t"), epoch_string(epoch)
    if name is None:
        raise InputError("is needed: fixes are Earth-fixed", field="epoch")
    span = np.array([at, at + number(until, "until", above=0.0)])
    tables = environment_of(nav.dynamics.force, name, span, environment)
    r, v, q = state
    covariance, bias = covariance_of(sigmas[0]), nav.gnss.bias
    mean = np.array([*position(r), *velocity(v)])
    if bias is not None:
        full = np.diag(np.repeat(bias.sigma**2, 9))
        full[:6, :6] = covariance
        mean, covariance = np.append(mean, np.zeros(3)), full
    orbit = _Filter(nav._orbit_core(tables), at, mean, covariance)
    made = GnssStarState(nav, name, orbit, number(sigmas[1], "sigma_q", above=0.0))
    if q is not None:
        own = np.array(one_quaternion(q, "q"))
        if nav.gyro is None:
            own = quaternion.multiply(quaternion.conjugate(orbital(made.r, made.v)), own)
        made._attitude = made._begin(own)
    return made
