"""Filters as values: which one, with which options. They run on any navigator."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from celestcore._check import number
from celestcore.errors import InputError

__all__ = ["EKF", "SRUKF", "UKF"]

_INTEGRATORS = ("exponential", "rk4")
_STATES = 6


@dataclass(frozen=True)
class EKF:
    """Multiplicative extended Kalman filter.

    First-order covariance of the error state, Joseph's form in the update, and the reset of the
    attitude error carried into the covariance (Lefferts, Markley, Shuster 1982; Markley 2003).

    Parameters
    ----------
    integrator : {"exponential", "rk4"}
        Attitude kinematics over a step of constant rate: the closed form, exact, or the classical
        Runge-Kutta method of the papers.

    Examples
    --------
    >>> EKF()
    EKF(integrator='exponential')
    """

    integrator: str = "exponential"
    kind: ClassVar[str] = "ekf"

    def __post_init__(self) -> None:
        _check_integrator(self.integrator)

    def _setup(self) -> dict[str, Any]:
        return {
            "filter": self.kind,
            "integrator": self.integrator,
            "alpha": 1.0,
            "beta": 2.0,
            "kappa": None,
        }


@dataclass(frozen=True)
class UKF:
    """Unscented Kalman filter on the error state, with 2N + 1 sigma points.

    Parameters
    ----------
    alpha : float
        Spread of the points, in (0, 1].
    beta : float
        Weight of the centre in the covariance, at least 0; 2 is best for normal errors.
    kappa : float, optional
        None: the papers' choice ``n + kappa = 3``. With N = 6 error states, ``kappa > -6``.
    integrator : {"exponential", "rk4"}
        Attitude kinematics of each sigma point.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    The scaled unscented transform (Wan and van der Merwe 2000), written on deviations from the
    centre point's image: no weight is negative as long as ``beta >= alpha**2``. Sigma points are
    drawn anew for each update, so that it sees the process noise.

    The update subtracts: where a sensor is a hundred million times better than what was known
    before (1-sigma), digits run out; `SRUKF`, and `EKF` by Joseph's form, keep what is left right.

    Examples
    --------
    >>> UKF(alpha=1e-3, kappa=0.0)
    UKF(alpha=0.001, beta=2.0, kappa=0.0, integrator='exponential')
    """

    alpha: float = 1.0
    beta: float = 2.0
    kappa: float | None = None
    integrator: str = "exponential"
    kind: ClassVar[str] = "ukf"

    def __post_init__(self) -> None:
        _check_integrator(self.integrator)
        alpha = number(self.alpha, "filter.alpha")
        if not 0.0 < alpha <= 1.0:
            raise InputError("must be in (0, 1]", field="filter.alpha", value=alpha)
        number(self.beta, "filter.beta", at_least=0.0)
        if self.kappa is not None:
            number(self.kappa, "filter.kappa", above=-_STATES)

    def _setup(self) -> dict[str, Any]:
        return {
            "filter": self.kind,
            "integrator": self.integrator,
            "alpha": float(self.alpha),
            "beta": float(self.beta),
            "kappa": None if self.kappa is None else float(self.kappa),
        }


@dataclass(frozen=True)
class SRUKF(UKF):
    """Square-root unscented Kalman filter: the covariance is never formed, factored or subtracted.

    For sensors of very different accuracy and for runs that never end. Same options as `UKF`, with
    ``beta >= alpha**2``, so that no downdate is needed.

    Examples
    --------
    >>> SRUKF()
    SRUKF(alpha=1.0, beta=2.0, kappa=None, integrator='exponential')
    """

    kind: ClassVar[str] = "srukf"

    def __post_init__(self) -> None:
        super().__post_init__()
        if not float(self.beta) >= float(self.alpha) ** 2:
            raise InputError(
                "must be at least alpha squared, so that no weight is negative",
                field="filter.beta",
                value=float(self.beta),
            )


def _check_integrator(value: str) -> None:
    if value not in _INTEGRATORS:
        raise InputError(
            f"must be one of {', '.join(_INTEGRATORS)}", field="filter.integrator", value=value
        )
