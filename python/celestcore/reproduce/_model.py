"""The experiment's constants, its simulations and its navigators; what is inferred says so."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

import celestcore as cc
from celestcore.reproduce._paper import GYRO, STAR
from celestcore.units import ARCSEC, ARCSEC_PER_S

Array = NDArray[np.float64]

SEMI_MAJOR_AXIS = 6_863_963.0
"""Table 1 [m]; the orbit is circular."""
RATE = 1.1102134571e-3
"""Orbital rate n [rad/s], with mu = 3.986004418e14 m^3/s^2."""
DURATION = 5659.4
"""One orbit [s]."""
GYRO_STEP = 0.1
STAR_STEP = 0.2
"""10 Hz and 5 Hz, Table 2 [s]."""
SKIP = 1000.0
"""What is not scored at the start (smoother: at both ends) [s]."""
SIGMAS = 3.0
"""The level of all quoted errors and results; inferred: no causal filter reaches the published
figures at another."""
BIAS_SIGMA = 1.0 * ARCSEC_PER_S
"""1 sigma of the gyro's bias at the start, per axis [rad/s]; inferred."""
BIAS_WALK = 1e-5 * ARCSEC_PER_S
"""1 sigma of its random walk [rad/s/sqrt(s)]; inferred."""
FIT_BIAS_SIGMA = 0.01 * ARCSEC_PER_S
"""The same as `BIAS_SIGMA` in blocks R1 and R2; inferred."""
R1_GYRO = 0.753
"""Process noise of all runs of block R1, as a gyro error [arcsec/s, 3 sigma]; fitted."""
R2_GYRO, R2_WALK = 0.379, 3.07e-3
"""The same of block R2, with a random walk of the bias [arcsec/s^1.5, 3 sigma]; fitted."""

# Columns: pitch (orbit normal), roll (along-track), yaw (nadir), as components in the body frame
# x forward, y right, z nadir: x_p = -y_b, y_p = x_b, z_p = z_b.
PAPER_AXES: Array = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
ROWS = (1, 0, 2)
"""Where pitch, roll and yaw stand among errors about the body axes x, y, z (signs aside)."""
BORESIGHTS: Array = np.array([[0.8, 0.5, -0.1], [-0.8, 0.5, -0.1]]) / np.sqrt(0.9)
"""Optical axes of the two cameras, paper axes (Table 1); 114.975 degrees apart."""


@dataclass(frozen=True)
class Cell:
    """One camera and one gyro of Tables 3 to 5; both errors are 3 sigma."""

    star: float
    """[arcsec]"""
    gyro: float
    """[arcsec/s]"""
    index: int


def cells() -> list[Cell]:
    """Return the 36 pairs, in the order of the tables."""
    pairs = [(star, gyro) for star in STAR for gyro in GYRO]
    return [Cell(star, gyro, k) for k, (star, gyro) in enumerate(pairs)]


def star_covariance(star: float) -> Array:
    """Return the noise of the two cameras together, (3, 3), body frame [rad^2].

    Each camera measures the two axes across its boresight u with s/3 and nothing about it:
    R = [sum (I - u u^T)]^-1 (s/3)^2.

    Parameters
    ----------
    star : float
        Error s of a camera [arcsec, 3 sigma].

    Examples
    --------
    >>> (3 * np.sqrt(np.diag(star_covariance(5.0))) / ARCSEC).round(2).tolist()
    [4.17, 6.58, 3.56]
    """
    information = sum(np.eye(3) - np.outer(u, u) for u in BORESIGHTS)
    paper = np.linalg.inv(information) * (star / SIGMAS * ARCSEC) ** 2
    body = PAPER_AXES @ paper @ PAPER_AXES.T
    return np.asarray(0.5 * (body + body.T))


def angle_random_walk(gyro: float) -> float:
    """Return the density [rad/sqrt(s)] of noise g/3 per sample, held over 0.1 s.

    Parameters
    ----------
    gyro : float
        Error g of the gyro [arcsec/s, 3 sigma].
    """
    return gyro / SIGMAS * ARCSEC_PER_S * float(np.sqrt(GYRO_STEP))


def tuned(cell: Cell, filter: Any) -> cc.StarGyroNavigator:  # noqa: A002 - the field's word
    """Return a navigator that knows the noise of its cell (block T)."""
    gyro = cc.Gyro(angle_random_walk(cell.gyro), BIAS_WALK)
    camera = cc.StarCamera(covariance=star_covariance(cell.star))
    return cc.StarGyroNavigator(filter, gyro, camera)


def fitted(cell: Cell, filter: Any, gyro: float, walk: float) -> cc.StarGyroNavigator:  # noqa: A002
    """Return a navigator with one process noise for all cells and isotropic R (R1, R2).

    Parameters
    ----------
    cell : Cell
    filter : EKF or UKF
    gyro : float
        Process noise as the error of a gyro [arcsec/s, 3 sigma].
    walk : float
        Random walk of the bias [arcsec/s^1.5, 3 sigma].
    """
    noise = cc.Gyro(angle_random_walk(gyro), walk / SIGMAS * ARCSEC_PER_S)
    camera = cc.StarCamera(sigma=cell.star / SIGMAS * ARCSEC)
    return cc.StarGyroNavigator(filter, noise, camera)


def figures(rms: Array) -> Array:
    """Return rms errors about the body axes (..., 3) [rad] as the paper's figures.

    Parameters
    ----------
    rms : array, (..., 3)
        About body x, y, z [rad].

    Returns
    -------
    array, (..., 3)
        Pitch, roll, yaw [arcsec, 3 sigma].
    """
    return np.asarray(SIGMAS * np.asarray(rms)[..., ROWS] / ARCSEC)
