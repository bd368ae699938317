"""Faults put into a log on purpose: what breaks in space, to see what an estimator makes of it.

Each function takes a log and gives another one; nothing is changed in place.

Examples
--------
>>> from celestcore import simulate
>>> truth = simulate.earth_pointing(60.0)
>>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
>>> log = scenario.simulate(seed=1).log
>>> blind = dropout(log, "star", 20.0, 40.0)
>>> len(log.stars["star"]) - len(blind.stars["star"])
200
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import quaternion
from celestcore._arguments import three
from celestcore._check import number
from celestcore._tables import parts_of
from celestcore.errors import InputError
from celestcore.log import SensorLog

__all__ = [
    "bias_step",
    "clock_jump",
    "dropout",
    "jump",
    "lost_axis",
    "outliers",
    "sign_flips",
    "stuck",
    "swapped",
]


def _changed(log: SensorLog, table: str, change: Callable[..., tuple[Any, ...]]) -> SensorLog:
    """Return a log with one table changed; its columns come as fresh arrays."""
    if table not in log.tables:
        known = ", ".join(log.tables)
        raise InputError(f"is no table of the log; they are {known}", field=table)
    tables: dict[str, Any] = dict(log.tables)
    tables[table] = change(*(np.array(column) for column in parts_of(log.tables[table])))
    if not len(tables[table][0]):
        del tables[table]
    return SensorLog(
        epoch=log.epoch, title=log.title, frames=log.frames, settings=log.settings or None, **tables
    )


def _during(t: Any, begin: float, end: float) -> Any:
    a, b = number(begin, "begin"), number(end, "end")
    if not a < b:
        raise InputError("must come after begin", field="end", value=b)
    return (t >= a) & (t < b)


def dropout(log: SensorLog, table: str, begin: float, end: float) -> SensorLog:
    """Leave out a sensor's rows: a blinded camera, a lost packet.

    Parameters
    ----------
    log : SensorLog
    table : str
        Name of the table, such as ``"star"``.
    begin, end : float
        Rows with ``begin <= t < end`` [s].

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 1.0, 2.0], [[0.0, 0.0, 0.0]] * 3))
    >>> dropout(log, "gyro", 0.5, 1.5).gyro.t
    array([0., 2.])
    """

    def change(t: Any, *columns: Any) -> tuple[Any, ...]:
        keep = ~_during(t, begin, end)
        return tuple(column[keep] for column in (t, *columns))

    return _changed(log, table, change)


def stuck(log: SensorLog, table: str, begin: float, end: float) -> SensorLog:
    """Repeat the value that a sensor had at `begin`.

    Parameters
    ----------
    log, table, begin, end
        As `dropout`.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 1.0, 2.0], [[0.0, 0.0, 1.0], [0.0, 0.0, 2.0], [0.0, 0.0, 3.0]]))
    >>> stuck(log, "gyro", 1.0, 9.0).gyro.rate[:, 2]
    array([1., 2., 2.])
    """

    def change(t: Any, value: Any, *rest: Any) -> tuple[Any, ...]:
        at = _during(t, begin, end)
        if at.any():
            value[at] = value[int(np.argmax(at))]
        return t, value, *rest

    return _changed(log, table, change)


def jump(log: SensorLog, table: str, begin: float, end: float, turn: ArrayLike) -> SensorLog:
    """Turn a star camera's fixes: a mount that slipped, a wrong star field.

    Parameters
    ----------
    log, table, begin, end
        As `dropout`.
    turn : array_like (3,)
        Rotation vector in the camera's frame [rad].

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(star=([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2))
    >>> jump(log, "star", 0.5, 2.0, [3.141592653589793, 0.0, 0.0]).stars["star"].q[1].round(6)
    array([0., 1., 0., 0.])
    """
    extra = quaternion.exp(np.array(three(turn, "turn")))

    def change(t: Any, q: Any, *rest: Any) -> tuple[Any, ...]:
        at = _during(t, begin, end)
        q[at] = quaternion.multiply(q[at], extra)
        return t, q, *rest

    return _changed(log, table, change)


def bias_step(log: SensorLog, begin: float, end: float, bias: ArrayLike) -> SensorLog:
    """Add a constant to the gyro's rates.

    Parameters
    ----------
    log, begin, end
        As `dropout`.
    bias : array_like (3,)
        [rad/s], gyro frame.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 1.0], [[0.0, 0.0, 0.0]] * 2))
    >>> bias_step(log, 1.0, 2.0, [0.0, 0.0, 0.1]).gyro.rate[:, 2]
    array([0. , 0.1])
    """
    extra = np.array(three(bias, "bias"))

    def change(t: Any, rate: Any, *rest: Any) -> tuple[Any, ...]:
        rate[_during(t, begin, end)] += extra
        return t, rate, *rest

    return _changed(log, "gyro", change)


def lost_axis(log: SensorLog, begin: float, end: float, axis: int) -> SensorLog:
    """Let one axis of the gyro read zero.

    Parameters
    ----------
    log, begin, end
        As `dropout`.
    axis : {0, 1, 2}
        Which.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 1.0], [[1.0, 2.0, 3.0]] * 2))
    >>> lost_axis(log, 0.5, 2.0, 1).gyro.rate[1]
    array([1., 0., 3.])
    """
    if axis not in (0, 1, 2):
        raise InputError("must be 0, 1 or 2", field="axis", value=axis)

    def change(t: Any, rate: Any, *rest: Any) -> tuple[Any, ...]:
        rate[_during(t, begin, end), axis] = 0.0
        return t, rate, *rest

    return _changed(log, "gyro", change)


def clock_jump(log: SensorLog, table: str, begin: float, seconds: float) -> SensorLog:
    """Move the time tags of a sensor from a time on.

    Parameters
    ----------
    log, table
        As `dropout`.
    begin : float
        From this tag on [s].
    seconds : float
        By so much; rows that would come before others fall away, as a reader drops them.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(gyro=([0.0, 1.0, 2.0], [[0.0, 0.0, 0.0]] * 3))
    >>> clock_jump(log, "gyro", 1.5, 3.0).gyro.t
    array([0., 1., 5.])
    """
    at, by = number(begin, "begin"), number(seconds, "seconds")

    def change(t: Any, *columns: Any) -> tuple[Any, ...]:
        late = t >= at
        t[late] += by
        last = t[~late][-1] if (~late).any() else -np.inf
        keep = ~late | (t > last)
        return tuple(column[keep] for column in (t, *columns))

    return _changed(log, table, change)


def sign_flips(log: SensorLog, table: str, share: float, seed: int = 0) -> SensorLog:
    """Flip signs of quaternions at random: the same attitudes, which must not matter.

    Parameters
    ----------
    log, table
        As `dropout`.
    share : float
        Of the fixes, from 0 to 1.
    seed : int
        Of the choice.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(star=([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2))
    >>> sign_flips(log, "star", 1.0).stars["star"].q[:, 0]
    array([-1., -1.])
    """
    part = number(share, "share", at_least=0.0)

    def change(t: Any, q: Any, *rest: Any) -> tuple[Any, ...]:
        q[np.random.default_rng(seed).random(len(t)) < part] *= -1.0
        return t, q, *rest

    return _changed(log, table, change)


def outliers(log: SensorLog, table: str, share: float, angle: float, seed: int = 0) -> SensorLog:
    """Turn fixes at random by a large angle about any axis: wrong star identifications.

    Parameters
    ----------
    log, table, share, seed
        As `sign_flips`.
    angle : float
        [rad].

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(star=([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2))
    >>> wrong = outliers(log, "star", 1.0, 0.1).stars["star"].q
    >>> quaternion.angle_between(wrong, [1.0, 0.0, 0.0, 0.0]).round(6)
    array([0.1, 0.1])
    """
    part, size = number(share, "share", at_least=0.0), number(angle, "angle")

    def change(t: Any, q: Any, *rest: Any) -> tuple[Any, ...]:
        rng = np.random.default_rng(seed)
        wrong = rng.random(len(t)) < part
        axis = rng.normal(size=(len(t), 3))
        axis /= np.linalg.norm(axis, axis=1, keepdims=True)
        turned = quaternion.multiply(q, quaternion.exp(size * axis))
        return t, np.where(wrong[:, None], turned, q), *rest

    return _changed(log, table, change)


def swapped(log: SensorLog, one: str, other: str) -> SensorLog:
    """Let two tables of a kind trade names: crossed cables.

    Parameters
    ----------
    log : SensorLog
    one, other : str
        Names of the tables.

    Returns
    -------
    SensorLog

    Raises
    ------
    InputError
        Names the field.

    Examples
    --------
    >>> log = SensorLog(star_1=([0.0], [[1.0, 0.0, 0.0, 0.0]]), star_2=([0.5], [[1.0, 0, 0, 0]]))
    >>> swapped(log, "star_1", "star_2").stars["star_1"].t
    array([0.5])
    """
    parts = {name: _parts(log, name) for name in (one, other)}
    made = _changed(log, one, lambda *_: parts[other])
    return _changed(made, other, lambda *_: parts[one])


def _parts(log: SensorLog, name: str) -> tuple[Any, ...]:
    if name not in log.tables:
        raise InputError(f"is no table of the log; they are {', '.join(log.tables)}", field=name)
    return tuple(np.array(column) for column in parts_of(log.tables[name]))
