"""How a simulated spacecraft turns about the orbital frame."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from celestcore import quaternion
from celestcore._arguments import checked
from celestcore._check import FloatArray, array, number
from celestcore.errors import InputError
from celestcore.units import DEG

__all__ = ["AttitudeProfile", "Slew"]

KINDS = ("turn", "return")
AXES = ("yaw", "pitch", "roll")


@dataclass(frozen=True)
class Slew:
    """A turn in pitch, away from the orbital frame.

    Parameters
    ----------
    angle : float
        How far [rad].
    duration : float
        How long [s].
    kind : {"turn", "return"}
        On and on at the constant rate ``angle / duration``, which a filter of rate and acceleration
        follows without lag; or there and back, ``angle sin^2(pi t / duration)``, where a filter
        without a gyro lags by minutes of arc if its white jerk is that of the undisturbed attitude.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> slew = Slew(120 * DEG, 1200.0, "return")
    >>> pitch, rate = slew.pitch([0.0, 600.0])
    >>> (pitch / DEG).round(6), rate.round(9) + 0.0
    (array([  0., 120.]), array([0., 0.]))
    """

    angle: float = 120.0 * DEG
    duration: float = 1200.0
    kind: str = "turn"

    def __post_init__(self) -> None:
        object.__setattr__(self, "angle", number(self.angle, "slew.angle"))
        object.__setattr__(self, "duration", number(self.duration, "slew.duration", above=0.0))
        if abs(self.angle) > 4.0 * np.pi:
            raise InputError("is in radians, not degrees", field="slew.angle", value=self.angle)
        if self.kind not in KINDS:
            raise InputError(
                f"must be one of {', '.join(KINDS)}", field="slew.kind", value=self.kind
            )

    def pitch(self, t: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the pitch and its rate.

        Parameters
        ----------
        t : array_like (n,)
            Times [s].

        Returns
        -------
        pitch, rate : ndarray (n,)
            [rad] and [rad/s].

        Examples
        --------
        >>> pitch, rate = Slew(1.0, 10.0).pitch([5.0])
        >>> pitch, rate
        (array([0.5]), array([0.1]))
        """
        part = array(t, "t") / self.duration
        if self.kind == "turn":
            return self.angle * part, np.full_like(part, self.angle / self.duration)
        turn = np.pi * part
        rate = self.angle * np.pi / self.duration * np.sin(2.0 * turn)
        return np.asarray(self.angle * np.sin(turn) ** 2), np.asarray(rate)


@dataclass(frozen=True)
class AttitudeProfile:
    """Attitude about the orbital frame: 3-2-1 angles that swing as sines of random phase.

    The defaults are those of the published experiment with a GPS receiver and a star sensor.

    Parameters
    ----------
    yaw, pitch, roll : (float, float)
        Amplitude [rad] and period [s].
    slew : Slew, optional
        A turn in pitch that is added.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> profile = AttitudeProfile(slew=Slew(120 * DEG, 1200.0))
    >>> profile.pitch[1], profile.slew
    (600.0, Slew(angle=2.0943951023931953, duration=1200.0, kind='turn'))
    """

    yaw: tuple[float, float] = (0.04 * DEG, 900.0)
    pitch: tuple[float, float] = (0.02 * DEG, 600.0)
    roll: tuple[float, float] = (0.03 * DEG, 400.0)
    slew: Slew | None = None

    def __post_init__(self) -> None:
        for name in AXES:
            pair = array(getattr(self, name), name, (2,))
            if not (np.isfinite(pair).all() and 0.0 <= pair[0] <= np.pi and pair[1] > 0.0):
                raise InputError("needs (amplitude [rad], period [s])", field=name, value=pair)
            object.__setattr__(self, name, (float(pair[0]), float(pair[1])))
        if self.slew is not None:
            checked(self.slew, "slew", Slew)

    def angles(self, t: ArrayLike, phases: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the 3-2-1 angles and their rates.

        Parameters
        ----------
        t : array_like (n,)
            Times [s].
        phases : array_like (3,)
            Of yaw, pitch and roll [rad].

        Returns
        -------
        angles, rates : ndarray (n, 3)
            Yaw, pitch, roll [rad] and what they change by [rad/s].

        Examples
        --------
        >>> angles, rates = AttitudeProfile().angles([0.0, 300.0], [0.0, 0.0, 0.0])
        >>> (angles / DEG).round(4)
        array([[ 0.    ,  0.    ,  0.    ],
               [ 0.0346,  0.    , -0.03  ]])
        """
        seconds, phase = array(t, "t", (None,)), array(phases, "phases", (3,))
        amplitude, period = np.array([getattr(self, name) for name in AXES]).T
        n = 2.0 * np.pi / period
        argument = seconds[:, None] * n + phase
        angles, rates = amplitude * np.sin(argument), amplitude * n * np.cos(argument)
        if self.slew is not None:
            pitch, rate = self.slew.pitch(seconds)
            angles[:, 1] += pitch
            rates[:, 1] += rate
        return angles, rates

    def attitude(self, t: ArrayLike, phases: ArrayLike) -> tuple[FloatArray, FloatArray]:
        """Return the attitude and the rate relative to the orbital frame.

        Parameters
        ----------
        t, phases
            As in `angles`.

        Returns
        -------
        q_ob : ndarray (n, 4)
            Body to orbital frame.
        rate : ndarray (n, 3)
            Of the body relative to the orbital frame, body frame [rad/s]; analytic.

        Notes
        -----
        ``q_ob = R3(yaw) R2(pitch) R1(roll)``. The rate is the sum of those of the three turns, each
        taken to the body frame; it has no singularity.

        Examples
        --------
        >>> q, rate = AttitudeProfile().attitude([0.0], [0.0, 0.0, 0.0])
        >>> q
        array([[1., 0., 0., 0.]])
        >>> (rate[0] / DEG * 3600).round(3)  # degrees an hour
        array([1.696, 0.754, 1.005])
        """
        angles, rates = self.angles(t, phases)
        axes = np.eye(3)
        about = [quaternion.exp(angles[:, k : k + 1] * axes[2 - k]) for k in range(3)]
        q = quaternion.multiply(quaternion.multiply(about[0], about[1]), about[2])
        _, pitch, roll = angles.T
        yaw_rate, pitch_rate, roll_rate = rates.T
        rate = np.stack(
            [
                roll_rate - yaw_rate * np.sin(pitch),
                pitch_rate * np.cos(roll) + yaw_rate * np.cos(pitch) * np.sin(roll),
                -pitch_rate * np.sin(roll) + yaw_rate * np.cos(pitch) * np.cos(roll),
            ],
            axis=1,
        )
        return quaternion.continuous(q), rate
