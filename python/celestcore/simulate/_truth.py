"""True attitudes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from celestcore import quaternion
from celestcore._arguments import one_quaternion, three
from celestcore._check import QUATERNION_HINT, FloatArray, array, number, times, unit_rows
from celestcore._check import quaternion as quaternions
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

MU_EARTH = 3.986004418e14
"""Gravitational parameter of the Earth [m^3/s^2]."""
MOST = 1e9
"""Samples beyond which a duration or step is taken for a mistake."""
CLOSE = 1e-6
"""A time that is so close to a sample, in steps, is that sample's."""


@dataclass(frozen=True, eq=False)
class Truth:
    """A true attitude over time; build one with `earth_pointing`, `slews` and so on.

    Attributes
    ----------
    t : ndarray (n,)
        Times [s], increasing.
    q : ndarray (n, 4)
        Attitudes ``q_ib`` then, scalar first, without sign jumps.
    rate : ndarray (n, 3)
        Mean body rate from each time to the next [rad/s]: the constant one that leads from this
        attitude to the next, ``log(q_k* q_k+1) / dt``. The last repeats the one before.

    Examples
    --------
    >>> import numpy as np
    >>> from celestcore import simulate
    >>> truth = simulate.constant_rate([0.0, 0.0, 0.01], 10.0, dt=0.5)
    >>> len(truth), truth.rate[3].round(6).tolist()
    (20, [0.0, 0.0, 0.01])
    >>> float(np.degrees(2 * np.arccos(truth.at(1.25)[0])).round(4))
    0.7162
    """

    t: FloatArray
    q: FloatArray
    rate: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        t = times(self.t, "truth.t")
        if len(t) < 2:
            raise InputError("needs two samples at least", field="truth.t")
        q = quaternions(self.q, "truth.q")
        if q.shape != (len(t), 4):
            raise InputError(f"has shape {q.shape}, needed is ({len(t)}, 4)", field="truth.q")
        bad = ~np.isfinite(q).all(axis=1)
        if bad.any():
            row = int(np.argmax(bad))
            raise InputError("must be finite", field="truth.q", row=row, value=q[row])
        unit_rows(q, "truth.q", what="quaternion", hint=QUATERNION_HINT)
        q = np.ascontiguousarray(quaternion.continuous(q))
        turn = quaternion.log(quaternion.multiply(quaternion.conjugate(q[:-1]), q[1:]))
        rate = turn / np.diff(t)[:, None]
        for name, value in (("t", t), ("q", q), ("rate", np.vstack([rate, rate[-1:]]))):
            value.flags.writeable = False
            object.__setattr__(self, name, value)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __repr__(self) -> str:
        return f"Truth({len(self)} samples, {self.t[0]:.10g} to {self.t[-1]:.10g} s)"

    def at(self, t: ArrayLike) -> FloatArray:
        """Return the attitude between samples, at the mean rate of each step.

        Parameters
        ----------
        t : float or array_like (m,)
            Times [s] within the truth's.

        Returns
        -------
        ndarray (4,) or (m, 4)
            ``q_ib``, scalar first.

        Raises
        ------
        InputError
            A time outside; names its row.

        Examples
        --------
        >>> from celestcore import quaternion, simulate
        >>> q = quaternion.exp([[0.0, 0.0, 0.0], [0.0, 0.0, 0.2]])
        >>> truth = simulate.attitude([0.0, 1.0], q)
        >>> quaternion.log(truth.at(0.5)).round(9)
        array([0. , 0. , 0.1])
        """
        asked = array(t, "t")
        inside = (asked >= self.t[0]) & (asked <= self.t[-1])
        if not inside.all():
            row = int(np.argmin(inside))
            span = f"{self.t[0]:.10g} to {self.t[-1]:.10g} s"
            raise InputError(
                f"must lie within {span}", field="t", row=row, value=asked.reshape(-1)[row]
            )
        k = np.clip(np.searchsorted(self.t, asked, side="right") - 1, 0, len(self) - 2)
        turn = self.rate[k] * (asked - self.t[k])[..., None]
        q = quaternion.multiply(self.q[k], quaternion.exp(turn))
        return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))

    def _snapped(self, t: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return times and attitudes; a time that is a sample's but for rounding becomes it."""
        near = np.searchsorted(self.t, t).clip(1, len(self) - 1)
        near -= t - self.t[near - 1] < self.t[near] - t
        step = self.t[np.minimum(near + 1, len(self) - 1)] - self.t[np.maximum(near - 1, 0)]
        same = np.abs(self.t[near] - t) <= CLOSE * step
        t = np.where(same, self.t[near], t)
        inside = (t >= self.t[0]) & (t <= self.t[-1])
        t, near, same = t[inside], near[inside], same[inside]
        return t, np.where(same[:, None], self.q[near], self.at(t))


def attitude(t: ArrayLike, q: QuaternionLike) -> Truth:
    """Return a truth of given attitudes.

    Parameters
    ----------
    t : array_like (n,)
        Times [s], increasing; the gyro samples at these.
    q : array_like (n, 4) or scipy Rotation
        Attitudes ``q_ib``, scalar first, of either sign; less than half a turn from each to the
        next.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        Names the field, row and value.

    Examples
    --------
    >>> from celestcore import simulate
    >>> simulate.attitude([0.0, 0.5, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 3)
    Truth(3 samples, 0 to 1 s)
    """
    return Truth(array(t, "t", (None,)), quaternions(q, "q"))


def constant_rate(
    rate: ArrayLike, duration: float, dt: float = 0.1, *, q0: QuaternionLike = (1.0, 0.0, 0.0, 0.0)
) -> Truth:
    """Return a turn at constant body rate.

    Parameters
    ----------
    rate : array_like (3,)
        Body rate [rad/s], less than half a turn a step.
    duration : float
        Length [s]; samples at 0, dt, 2 dt ... before it.
    dt : float
        Step of the samples [s].
    q0 : array_like (4,) or scipy Rotation
        Attitude ``q_ib`` at time 0.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore import simulate
    >>> simulate.constant_rate([0.0, 0.01, 0.0], 60.0, dt=0.5)
    Truth(120 samples, 0 to 59.5 s)
    """
    t = _times(duration, dt)
    w = np.array(three(rate, "rate"))
    if float(np.linalg.norm(w)) * float(dt) >= np.pi:
        raise InputError("turns by half a turn or more in a step", field="rate", value=w)
    start = np.array(one_quaternion(q0, "q0"))
    return Truth(t, _unit(quaternion.multiply(start, quaternion.exp(t[:, None] * w))))


def earth_pointing(
    duration: float,
    dt: float = 0.1,
    *,
    semi_major_axis: float = 6_863_963.0,
    inclination: float = np.radians(97.3716),
    raan: float = 0.0,
    argument_of_latitude: float = 0.0,
    mu: float = MU_EARTH,
) -> Truth:
    """Return the attitude of a body that points to the Earth on a circular orbit.

    The body axes are those of the orbital frame: x forward, y to the right (against the orbit's
    normal), z to the nadir. They turn at ``(0, -n, 0)``, ``n = sqrt(mu / a^3)``. The default orbit
    is that of the published star camera and gyro experiment.

    Parameters
    ----------
    duration : float
        Length [s]; samples at 0, dt, 2 dt ... before it.
    dt : float
        Step of the samples [s].
    semi_major_axis : float
        Radius of the orbit [m].
    inclination, raan, argument_of_latitude : float
        Orientation of the orbit, and place on it at time 0 [rad]. They choose the attitude at time
        0 and nothing else.
    mu : float
        Gravitational parameter [m^3/s^2].

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore import simulate
    >>> truth = simulate.earth_pointing(5659.4)
    >>> len(truth), truth.rate[0].round(9).tolist()
    (56594, [-0.0, -0.001110213, 0.0])
    """
    t = _times(duration, dt)
    a = number(semi_major_axis, "semi_major_axis", above=0.0)
    n = np.sqrt(number(mu, "mu", above=0.0) / a**3)
    if n * float(dt) >= np.pi:
        raise InputError("is half an orbit or more", field="dt", value=dt)
    node, i, u = (
        number(value, name)
        for value, name in (
            (raan, "raan"),
            (inclination, "inclination"),
            (argument_of_latitude, "argument_of_latitude"),
        )
    )
    # the columns of in_plane: forward, against the normal, nadir
    turned = np.array(
        [[np.cos(node), -np.sin(node), 0], [np.sin(node), np.cos(node), 0], [0, 0, 1]]
    )
    tilted = np.array([[1, 0, 0], [0, np.cos(i), -np.sin(i)], [0, np.sin(i), np.cos(i)]])
    in_plane = np.array([[-np.sin(u), 0, -np.cos(u)], [np.cos(u), 0, -np.sin(u)], [0, -1, 0]])
    q0 = quaternion.from_matrix(turned @ tilted @ in_plane)
    turn = quaternion.exp(t[:, None] * [0.0, -n, 0.0])
    return Truth(t, _unit(quaternion.multiply(q0, turn)))


def slews(
    duration: float,
    dt: float = 0.1,
    *,
    angle: float = np.radians(60.0),
    slew_time: float = 60.0,
    hold_time: float = 20.0,
    axes: Sequence[ArrayLike] = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    q0: QuaternionLike = (1.0, 0.0, 0.0, 0.0),
) -> Truth:
    """Return smooth slews from rest to rest, there and back about one body axis after the other.

    The angle follows ``angle (10 s^3 - 15 s^4 + 6 s^5)``, ``s`` from 0 to 1: rate and acceleration
    are zero at both ends. Manoeuvres of this kind make scale factors and misalignments of a gyro
    observable.

    Parameters
    ----------
    duration : float
        Length [s]; samples at 0, dt, 2 dt ... before it. The cycle of axes repeats.
    dt : float
        Step of the samples [s].
    angle : float
        Size of each slew [rad].
    slew_time, hold_time : float
        Length of each slew and of the rest after it [s]. The largest rate is
        ``1.875 angle / slew_time``.
    axes : sequence of array_like (3,)
        Body axes, of any length but zero.
    q0 : array_like (4,) or scipy Rotation
        Attitude ``q_ib`` at time 0.

    Returns
    -------
    Truth

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore import simulate
    >>> truth = simulate.slews(480.0, dt=0.5, angle=1.0)
    >>> bool(abs(truth.rate).max(axis=0).min() > 0.03)     # every axis turns
    True
    """
    t = _times(duration, dt)
    size = number(angle, "angle")
    moving = number(slew_time, "slew_time", above=0.0)
    cycle = moving + number(hold_time, "hold_time", at_least=0.0)
    directions = array(list(axes), "axes", (None, 3))
    length = np.linalg.norm(directions, axis=1, keepdims=True)
    if len(directions) == 0 or not (np.isfinite(length) & (length > 0.0)).all():
        raise InputError("needs directions of non-zero length", field="axes", value=axes)
    which = np.floor(t / cycle).astype(np.int64)
    s = np.clip((t - which * cycle) / moving, 0.0, 1.0)
    done = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    # there on even slews, back on odd ones: every second rest is at q0
    turned = size * np.where(which % 2 == 0, done, 1.0 - done)
    axis = (directions / length)[which // 2 % len(directions)]
    if abs(size) * 1.875 / moving * float(dt) >= np.pi:
        raise InputError("turns by half a turn or more in a step", field="angle", value=size)
    start = np.array(one_quaternion(q0, "q0"))
    return Truth(t, _unit(quaternion.multiply(start, quaternion.exp(turned[:, None] * axis))))


def _times(duration: float, dt: float) -> FloatArray:
    length = number(duration, "duration", above=0.0)
    step = number(dt, "dt", above=0.0)
    count = np.ceil(length / step - CLOSE)
    if not 2 <= count <= MOST:
        raise InputError(
            f"makes {count:.10g} samples of {step:.10g} s; 2 to {MOST:g} are possible",
            field="duration",
            value=length,
        )
    return np.arange(int(count), dtype=np.float64) * step


def _unit(q: FloatArray) -> FloatArray:
    return np.asarray(q / np.linalg.norm(q, axis=-1, keepdims=True))
