"""What the paper prints: Tables 1 to 3.

Ning Xiao-lin, Ma Xin, Analysis of filtering methods for satellite celestial navigation, Control
Theory & Applications, 2010.
"""

from __future__ import annotations

from typing import NamedTuple

CITATION = (
    "Ning Xiao-lin, Ma Xin, Analysis of filtering methods for satellite celestial navigation, "
    "Control Theory & Applications, 2010"
)
COLUMNS = ("EKF", "UKF", "UPF")


class Row(NamedTuple):
    """One row of Table 1 or 2; positions [m], velocities [m/s]."""

    mean_pos: float
    mean_vel: float
    max_pos: float
    max_vel: float


TABLE_1 = {
    3.0: {
        "EKF": Row(181.1141, 0.1700, 731.3966, 0.6570),
        "UKF": Row(150.2162, 0.1444, 540.5632, 0.5472),
        "UPF": Row(135.7285, 0.1432, 489.9312, 0.5287),
    },
    30.0: {
        "EKF": Row(646.1042, 0.5844, 2967.5, 2.3047),
        "UKF": Row(238.9116, 0.2330, 684.4990, 0.6246),
        "UPF": Row(193.9783, 0.1897, 547.5536, 0.5434),
    },
    60.0: {
        "EKF": Row(1792.1, 1.8340, 7235.5, 6.6416),
        "UKF": Row(338.5030, 0.3355, 1127.6, 1.0432),
        "UPF": Row(305.7217, 0.3270, 1007.1, 1.0186),
    },
}
"""By filter period [s]."""
TABLE_2 = {
    "normal": {
        "EKF": Row(374.3222, 0.3331, 1235.8, 1.1195),
        "UKF": Row(217.3204, 0.2089, 540.5632, 0.4631),
        "UPF": Row(198.7682, 0.2015, 534.8064, 0.4598),
    },
    "student_t": {
        "EKF": Row(223.1578, 0.2362, 533.4111, 0.5328),
        "UKF": Row(194.2001, 0.1849, 528.8101, 0.4195),
        "UPF": Row(187.3548, 0.1846, 519.1896, 0.4133),
    },
    "uniform": {
        "EKF": Row(294.0916, 0.2881, 629.9934, 0.7346),
        "UKF": Row(205.4600, 0.2007, 527.5990, 0.4219),
        "UPF": Row(197.3377, 0.1919, 501.2496, 0.4146),
    },
}
"""By distribution of the measurement noise; the period is 15 s."""
TABLE_3 = {"EKF": 1.5, "UKF": 3.5, "UPF": 60.0}
"""Seconds an orbit, at a period of 3 s; the UPF has 20 particles."""
PERIOD_2, PERIOD_3 = 15.0, 3.0
STATES, PARTICLES = 6, 20


def row(period: float, distribution: str, column: str | None) -> Row | None:
    """Return what the paper prints for a cell, if it does.

    Parameters
    ----------
    period : float
        Filter period [s].
    distribution : str
        Of the noise, as in `TABLE_2`.
    column : str or None
        As in `COLUMNS`.

    Examples
    --------
    >>> row(15.0, "normal", "UKF").mean_pos, row(30.0, "uniform", "UKF"), row(3.0, "normal", None)
    (217.3204, None, None)
    """
    if column is None:
        return None
    if period == PERIOD_2:
        return TABLE_2.get(distribution, {}).get(column)
    return TABLE_1.get(period, {}).get(column) if distribution == "normal" else None


def complexity(column: str, *, diagonal: bool = False, n: int = STATES) -> int:
    """Return the operations of one step by the formulas of Table 3.

    Parameters
    ----------
    column : str
        As in `COLUMNS`.
    diagonal : bool
        Whether the transition matrix is taken as diagonal (it is not: it couples position and
        velocity).
    n : int
        States.

    Examples
    --------
    >>> [complexity(name) for name in COLUMNS]
    [780, 953, 19060]
    >>> complexity("EKF", diagonal=True)
    240
    """
    if column == "EKF":
        return 6 * n**2 + 4 * n if diagonal else 3 * n**3 + 3 * n**2 + 4 * n
    unscented = 2 * n**3 + 12 * n**2 + 14 * n + 5
    return unscented * (PARTICLES if column == "UPF" else 1)
