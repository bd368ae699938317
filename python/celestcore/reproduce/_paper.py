"""What the paper prints: Tables 3 to 5, and what its text says of them.

Wang Yu, Jiang Wei-jiao, High Precision Attitude Determination Method for Star Camera Based on UKF,
Acta Photonica Sinica 49(1), 2020, 0128001.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

CITATION = (
    "Wang Yu, Jiang Wei-jiao, High Precision Attitude Determination Method for Star Camera Based "
    "on UKF, Acta Photonica Sinica 49(1), 2020, 0128001"
)
STAR = (5.0, 2.0, 1.0)
"""Star camera errors of Tables 3, 4 and 5 [arcsec]; 3 sigma (inferred)."""
GYRO = (0.2, 0.4, 0.6, 0.8, 1.0, 1.2, 1.4, 1.6, 1.8, 2.0, 2.2, 2.4)
"""Gyro errors, the rows of each table [arcsec/s]; 3 sigma of a 0.1 s sample (inferred)."""
AXES = ("pitch", "roll", "yaw")

# Table 3's last three roll figures stand there as "1.370 8", "1.570 7" and "1.699 1": the journal
# parts the decimals by threes, and these three were not rounded to two decimals like the rest.
_TABLES = """
0.2  0.72 0.43 0.39  0.67 0.42   0.37
0.4  0.75 0.52 0.47  0.73 0.47   0.43
0.6  0.82 0.64 0.60  0.79 0.58   0.56
0.8  0.94 0.77 0.74  0.85 0.66   0.63
1.0  1.03 0.89 0.90  0.94 0.80   0.77
1.2  1.17 1.08 1.03  1.06 0.92   0.88
1.4  1.34 1.18 1.20  1.13 1.02   1.01
1.6  1.48 1.37 1.29  1.28 1.21   1.12
1.8  1.62 1.55 1.48  1.41 1.27   1.31
2.0  1.74 1.64 1.67  1.56 1.3708 1.36
2.2  1.95 1.77 1.81  1.68 1.5707 1.58
2.4  1.95 2.01 2.12  1.72 1.6991 1.67

0.2  0.35 0.24 0.21  0.40 0.26 0.22
0.4  0.41 0.30 0.28  0.43 0.30 0.26
0.6  0.45 0.40 0.39  0.45 0.35 0.32
0.8  0.56 0.49 0.47  0.52 0.42 0.40
1.0  0.64 0.61 0.61  0.58 0.50 0.47
1.2  0.76 0.72 0.65  0.63 0.58 0.56
1.4  0.84 0.80 0.79  0.71 0.66 0.63
1.6  0.95 0.92 0.92  0.76 0.73 0.72
1.8  1.05 1.05 1.01  0.85 0.81 0.80
2.0  1.16 1.15 1.10  0.92 0.88 0.88
2.2  1.30 1.26 1.33  1.01 0.95 0.94
2.4  1.34 1.36 1.42  1.12 1.02 1.01

0.2  0.24 0.16 0.14  0.28 0.19 0.16
0.4  0.27 0.21 0.19  0.30 0.22 0.19
0.6  0.33 0.27 0.27  0.34 0.25 0.24
0.8  0.39 0.36 0.35  0.36 0.30 0.28
1.0  0.48 0.41 0.42  0.41 0.34 0.32
1.2  0.55 0.52 0.50  0.45 0.39 0.38
1.4  0.60 0.60 0.57  0.51 0.45 0.44
1.6  0.70 0.69 0.67  0.54 0.51 0.50
1.8  0.76 0.75 0.75  0.61 0.56 0.55
2.0  0.84 0.82 0.79  0.64 0.61 0.60
2.2  0.97 0.91 0.93  0.70 0.66 0.66
2.4  1.01 1.01 1.01  0.76 0.73 0.73
"""


def _parse(text: str) -> Array:
    return np.array([line.split() for line in text.split("\n") if line], dtype=float)


_ROWS = _parse(_TABLES).reshape(len(STAR), len(GYRO), 7)
EKF: Array = _ROWS[:, :, 1:4]
"""The EKF columns (camera, gyro, axis) [arcsec, 3 sigma]."""
UKF: Array = _ROWS[:, :, 4:]
"""The UKF columns (camera, gyro, axis) [arcsec, 3 sigma]."""

GAINS = ((9, 12, 13), (16, 20, 21), (19, 23, 23))
"""By how much its UKF is better than its EKF, as the text says: camera, axis [%]."""

READINGS = (
    ("2″ camera, all axes better than 1″", "EKF", 2.0, None, 1.6),
    ("2″ camera, all axes better than 1″", "UKF", 2.0, None, 2.2),
    ("5″ camera, yaw of 1″", "UKF", 5.0, "yaw", 1.4),
    ("2″ camera, yaw of 1″", "UKF", 2.0, "yaw", 2.4),
)
"""The gyros that the text reads off its tables: what, column, camera, axis (None: the worst),
gyro error [arcsec/s]."""


def gains(better: Array, worse: Array, *, wins_only: bool = False) -> Array:
    """Return by how much one set of figures is below another, mean over the gyros [%].

    Parameters
    ----------
    better, worse : array, (camera, gyro, axis)
    wins_only : bool
        Leave out the figures in which it is not below.

    Returns
    -------
    array, (camera, axis)

    Examples
    --------
    >>> gains(UKF, EKF).round(1).tolist()
    [[9.9, 12.2, 13.1], [10.7, 15.8, 17.8], [12.0, 16.7, 18.4]]

    The text's own means (`GAINS`) are near those over the figures that its UKF wins:

    >>> gains(UKF, EKF, wins_only=True).round(1).tolist()
    [[9.9, 12.2, 13.1], [16.4, 19.8, 19.8], [19.4, 22.3, 23.5]]
    """
    gain = 1.0 - better / worse
    counted = gain > 0.0 if wins_only else np.ones(gain.shape, dtype=np.bool_)
    return np.asarray(100.0 * np.mean(gain, axis=1, where=counted))


def reading(figures: Array, star: float, axis: str | None, target: float = 1.0) -> float | None:
    """Return the gyro error with which a column reaches an accuracy, read between its rows.

    Parameters
    ----------
    figures : array, (camera, gyro, axis)
    star : float
        Error of the camera [arcsec].
    axis : str or None
        None: the worst of the three axes.
    target : float
        Accuracy to be reached [arcsec, 3 sigma].

    Returns
    -------
    float or None
        Gyro error [arcsec/s]; None if all rows reach it.

    Examples
    --------
    >>> round(reading(EKF, 2.0, None), 2), round(reading(UKF, 2.0, None), 2)
    (1.7, 2.18)
    """
    rows = figures[STAR.index(star)]
    column = rows.max(axis=1) if axis is None else rows[:, AXES.index(axis)]
    above = np.flatnonzero(column > target)
    if len(above) == 0:
        return None
    k = int(above[0])
    if k == 0:
        return float(GYRO[0])
    part = (target - column[k - 1]) / (column[k] - column[k - 1])
    return float(GYRO[k - 1] + part * (GYRO[k] - GYRO[k - 1]))
