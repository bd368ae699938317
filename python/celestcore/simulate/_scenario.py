"""Scenarios and their trials."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from celestcore import _core, quaternion
from celestcore._arguments import checked
from celestcore._check import FloatArray, number
from celestcore.camera import CameraModel
from celestcore.errors import InputError
from celestcore.log import SensorLog
from celestcore.navigator import AttitudeFilter, StarGyroNavigator
from celestcore.sensors import Gyro
from celestcore.simulate._field import StarField
from celestcore.simulate._sensors import GyroErrors, StarErrors
from celestcore.simulate._truth import Truth
from celestcore.solution import Solution

Camera: TypeAlias = "StarErrors | StarField | CameraModel"

CAMERAS = 64
"""Largest number of star cameras."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """One trial: what the sensors reported, and what was true.

    Attributes
    ----------
    log : SensorLog
        The gyro and the star cameras. Fixes of `StarErrors` carry no noise of their own: a
        navigator's camera says what it assumes. Those of a physical camera carry the covariance
        that follows from their stars, and frames without a fix are missing rows.
    truth : Truth
        The attitude.
    bias : ndarray (n, 3)
        Bias and drift at the times of the truth, body frame [rad/s].
    seed, trial : int
        What it was drawn with.

    Examples
    --------
    >>> from celestcore import simulate
    >>> truth = simulate.earth_pointing(20.0)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
    >>> made = scenario.simulate(seed=1, trial=7)
    >>> made.log, made.bias.shape
    (SensorLog(19.9 s: gyro 200 rows, star ... rows), (200, 3))
    """

    log: SensorLog
    truth: Truth
    bias: FloatArray
    seed: int
    trial: int

    def error(self, solution: Solution) -> FloatArray:
        """Return the errors of a solution: truth less estimate.

        Parameters
        ----------
        solution : Solution
            Of this trial's log.

        Returns
        -------
        ndarray (m, 6)
            At the solution's times: attitude, body-frame rotation vector [rad], and bias [rad/s].

        Raises
        ------
        InputError
            A time outside the truth's.

        Examples
        --------
        >>> from celestcore import simulate
        >>> truth = simulate.attitude([0.0, 1.0], [[1.0, 0.0, 0.0, 0.0]] * 2)
        >>> scenario = simulate.Scenario(
        ...     truth, simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5))
        >>> made = scenario.simulate(seed=1)
        >>> made.error(scenario.navigator().run(made.log)).shape
        (2, 6)
        """
        t = np.asarray(solution.t)
        turn = quaternion.log(
            quaternion.multiply(quaternion.conjugate(solution.q), self.truth.at(t))
        )
        bias = [np.interp(t, self.truth.t, axis) for axis in self.bias.T]
        return np.hstack([turn, np.stack(bias, axis=1) - solution.bias])


@dataclass(frozen=True, eq=False)
class Scenario:
    """What is flown and with which sensors.

    Parameters
    ----------
    truth : Truth
        The attitude; the gyro samples at its times.
    gyro : GyroErrors
        The gyro.
    star : StarErrors, StarField, CameraModel, or dict of str to these
        The star camera, or cameras by the names of their tables (``"star"``, ``"star_1"`` ...):
        noise on the attitude, or a physical camera that sees stars. A `CameraModel` alone takes a
        frame at every sample; `StarField` gives it times.
        Random numbers go by the place: a camera that is added last changes nothing of the others.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> import celestcore as cc
    >>> from celestcore import simulate
    >>> truth = simulate.earth_pointing(60.0)
    >>> star = simulate.StarErrors(2 * cc.ARCSEC, every=2)
    >>> scenario = simulate.Scenario(truth, simulate.GyroErrors(arw=1e-6), star)
    >>> scenario.simulate(seed=7, trial=3).log
    SensorLog(59.9 s: gyro 600 rows, star 300 rows)
    """

    truth: Truth
    gyro: GyroErrors
    star: Camera | Mapping[str, Camera]

    def __post_init__(self) -> None:
        checked(self.truth, "truth", Truth)
        checked(self.gyro, "gyro", GyroErrors)
        given = self.star if isinstance(self.star, Mapping) else {"star": self.star}
        for name, camera in given.items():
            checked(camera, str(name), StarErrors, StarField, CameraModel)
        if not 1 <= len(self.cameras) <= CAMERAS:
            raise InputError(f"needs 1 to {CAMERAS} star cameras", field="star")
        for name in self.cameras:
            if name != "star" and not name.startswith("star_"):
                raise InputError("must be 'star' or begin with 'star_'", field="star", value=name)

    @property
    def cameras(self) -> dict[str, StarErrors | StarField]:
        """The star cameras by the names of their tables."""
        given = self.star if isinstance(self.star, Mapping) else {"star": self.star}
        return {n: StarField(c) if isinstance(c, CameraModel) else c for n, c in given.items()}

    def simulate(self, seed: int = 0, trial: int = 0) -> Simulation:
        """Return one trial.

        Parameters
        ----------
        seed : int
            Chooses the random numbers of all trials, from 0 to 2**64 - 1.
        trial : int
            Number of the trial, from 0 to 2**56 - 1.

        Returns
        -------
        Simulation
            The same bits for the same seed and trial.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> from celestcore import simulate
        >>> truth = simulate.earth_pointing(20.0)
        >>> gyro, star = simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5)
        >>> scenario = simulate.Scenario(truth, gyro, star)
        >>> once, again = (scenario.simulate(seed=1, trial=7) for _ in range(2))
        >>> bool((once.log.gyro.rate == again.log.gyro.rate).all())
        True
        """
        seed, trial = whole(seed, "seed", 64), whole(trial, "trial", 56)
        flight = self._described()
        rate, bias, fixes = _core.simulate(flight, seed, trial)
        tables: dict[str, Any] = {
            name: _table(camera[0], q, own)
            for name, camera, (q, own) in zip(self.cameras, flight["cameras"], fixes, strict=True)
        }
        log = SensorLog(gyro=(self.truth.t, rate), **tables)
        bias.flags.writeable = False
        return Simulation(log=log, truth=self.truth, bias=bias, seed=seed, trial=trial)

    def navigator(self, filter: AttitudeFilter | None = None) -> StarGyroNavigator:  # noqa: A002
        """Return a navigator that knows the noise and the mountings as they are simulated.

        Where the axes of the gyro differ, it gets the noise of the worst. A drift, scale factors,
        misalignments and quantisation are not in its model.

        Parameters
        ----------
        filter : EKF, UKF, SRUKF or other, optional
            The filter; by default an EKF.

        Returns
        -------
        StarGyroNavigator

        Raises
        ------
        InputError
            If the gyro has no white noise: a filter needs some.

        Examples
        --------
        >>> from celestcore import simulate
        >>> truth = simulate.earth_pointing(20.0)
        >>> gyro, star = simulate.GyroErrors(1e-6), simulate.StarErrors(1e-5)
        >>> scenario = simulate.Scenario(truth, gyro, star)
        >>> scenario.navigator().gyro.arw
        1e-06
        """
        arw, rrw = np.max(self.gyro.arw), np.max(self.gyro.rrw)
        star = {
            name: camera.camera if isinstance(camera, StarErrors) else camera.sensor()
            for name, camera in self.cameras.items()
        }
        return StarGyroNavigator(filter, Gyro(arw, rrw, mounting=self.gyro.mounting), star)

    def _described(self) -> dict[str, Any]:
        """Return what the core takes."""
        return {
            "t": self.truth.t,
            "q": self.truth.q,
            "rate": self.truth.rate,
            "gyro": self.gyro._described(),
            "cameras": [c._described(name, self.truth) for name, c in self.cameras.items()],
        }


def _table(t: FloatArray, q: FloatArray, own: tuple[Any, FloatArray] | None) -> tuple[Any, ...]:
    """Return a camera's table; frames that gave no fix are rows of NaN."""
    if own is None:
        return t, q
    frame, covariance = own
    every_q, every_p = np.full((len(t), 4), np.nan), np.full((len(t), 3, 3), np.nan)
    every_q[frame], every_p[frame] = q, covariance
    return t, every_q, every_p


def log(
    truth: Truth,
    gyro: GyroErrors,
    star: Camera | Mapping[str, Camera],
    *,
    seed: int = 0,
    trial: int = 0,
) -> Simulation:
    """Return one trial of a scenario; short for ``Scenario(truth, gyro, star).simulate(...)``.

    Parameters
    ----------
    truth : Truth
        The attitude.
    gyro : GyroErrors
        The gyro.
    star : StarErrors, StarField, CameraModel, or dict of str to these
        The star camera or cameras.
    seed, trial : int
        See `Scenario.simulate`.

    Returns
    -------
    Simulation

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> from celestcore import simulate
    >>> truth, gyro = simulate.earth_pointing(10.0), simulate.GyroErrors(1e-6)
    >>> made = simulate.log(truth, gyro, simulate.StarErrors(1e-5, period=1.0), seed=1)
    >>> made.log.stars["star"].t
    array([0., 1., 2., 3., 4., 5., 6., 7., 8., 9.])
    """
    return Scenario(truth, gyro, star).simulate(seed, trial)


def whole(value: int, field: str, bits: int) -> int:
    """Return a whole number from 0 to 2**bits - 1."""
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        n = int(value)
    else:
        given = number(value, field)
        if given != np.floor(given):
            raise InputError("must be a whole number", field=field, value=value)
        n = int(given)
    if not 0 <= n < 2**bits:
        raise InputError(f"must be from 0 to 2**{bits} - 1", field=field, value=value)
    return n
