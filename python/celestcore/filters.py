"""Filters as values: which one, with which options."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

from celestcore._check import number
from celestcore.errors import InputError

__all__ = [
    "EKF",
    "SRUKF",
    "UKF",
    "UPF",
    "BootstrapPF",
    "InvariantEKF",
    "IteratedEKF",
    "LiteralUKF",
    "ScoreEKF",
]

_INTEGRATORS = ("exponential", "rk4")
_STATES = 6
RESAMPLING = ("systematic", "stratified", "residual", "multinomial")
FORMS = ("proposal", "literal", "bank")


def _setup(kind: str, **options: Any) -> dict[str, Any]:
    """Return what the core wants to know of a filter, options that do not apply included."""
    return {
        "filter": kind,
        "integrator": "exponential",
        "alpha": 1.0,
        "beta": 2.0,
        "kappa": None,
        "reset": True,
        "iterations": 0,
        "tolerance": 0.0,
        "particles": None,
        "random": (0, 0),
        **options,
    }


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
    reset : bool
        Whether the covariance is carried over the reset of the attitude error; older filters leave
        it as it is, which shows at errors of tens of degrees.

    Examples
    --------
    >>> EKF()
    EKF(integrator='exponential', reset=True)
    """

    integrator: str = "exponential"
    reset: bool = True
    kind: ClassVar[str] = "ekf"

    def __post_init__(self) -> None:
        _check_integrator(self.integrator)

    def _setup(self) -> dict[str, Any]:
        return _setup(self.kind, integrator=self.integrator, reset=bool(self.reset))


@dataclass(frozen=True)
class IteratedEKF:
    """Extended Kalman filter that re-linearises the last interval, for wild starts and slow fixes.

    At each epoch of measurements the estimate at the epoch before, the gyro samples since and all
    measurements of the epoch are linearised about their joint estimate again and again until it
    stays: Gauss-Newton on the two ends of the interval (Jazwinski 1970, section 8.3; Bell and
    Cathey 1993). Where an `EKF` is good, this gives the same at several times the cost.

    Parameters
    ----------
    iterations : int
        Most iterations per epoch; if the estimate has not come to rest by then, the `EKF`'s stands.
    tolerance : float
        The estimate is at rest when it moves by less than so many standard deviations.
    integrator : {"exponential", "rk4"}
        Attitude kinematics.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Replays whole logs (`StarGyroNavigator.run`, `smooth`), not sample by sample: it needs the gyro
    samples since the fix before.

    Examples
    --------
    >>> IteratedEKF(iterations=5)
    IteratedEKF(iterations=5, tolerance=0.001, integrator='exponential')
    """

    iterations: int = 50
    tolerance: float = 1e-3
    integrator: str = "exponential"
    kind: ClassVar[str] = "iterated"

    def __post_init__(self) -> None:
        _check_integrator(self.integrator)
        if number(self.iterations, "filter.iterations", at_least=1) != int(self.iterations):
            raise InputError(
                "must be a whole number", field="filter.iterations", value=self.iterations
            )
        number(self.tolerance, "filter.tolerance", above=0.0)

    def _setup(self) -> dict[str, Any]:
        return _setup(
            self.kind,
            integrator=self.integrator,
            iterations=int(self.iterations),
            tolerance=float(self.tolerance),
        )


@dataclass(frozen=True)
class InvariantEKF:
    """Right-invariant extended Kalman filter: the attitude error is on the inertial side.

    ``q = exp(xi) * q_hat`` with xi in inertial axes; the transition does not depend on the attitude
    estimate, and the covariance is not carried over the reset (Barrau and Bonnabel 2017; with a
    gyro bias beside the rotation it is their "imperfect" filter). Converges from large errors
    more often than `EKF`; with small ones it gives the same.

    Parameters
    ----------
    integrator : {"exponential", "rk4"}
        Attitude kinematics.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Replays whole logs, not sample by sample. Results are in the body frame, as of every filter.

    Examples
    --------
    >>> InvariantEKF()
    InvariantEKF(integrator='exponential')
    """

    integrator: str = "exponential"
    kind: ClassVar[str] = "invariant"

    def __post_init__(self) -> None:
        _check_integrator(self.integrator)

    def _setup(self) -> dict[str, Any]:
        return _setup(self.kind, integrator=self.integrator)


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
        return _setup(
            self.kind,
            integrator=self.integrator,
            alpha=float(self.alpha),
            beta=float(self.beta),
            kappa=None if self.kappa is None else float(self.kappa),
        )


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


@dataclass(frozen=True)
class ScoreEKF:
    """Score-function filter: an extended Kalman filter that knows the distribution of the noise.

    Each angle corrects by the exact posterior mean and variance of what it measures, under the
    distribution that `StarHorizon` gives it (Masreliez 1975). With normal noise it is the `EKF`;
    with uniform noise it is far better than any filter that knows the variance alone.

    Notes
    -----
    For orbits (`CelestialNavigator`). Angles are used one by one: a nadir direction combined from
    several has no closed-form distribution.

    Examples
    --------
    >>> ScoreEKF().kind
    'score'
    """

    kind: ClassVar[str] = "score"

    def _setup(self) -> dict[str, Any]:
        return _setup(self.kind)


@dataclass(frozen=True)
class LiteralUKF(UKF):
    """The unscented filter of Wang and Jiang (2020) on their 7-dimensional state, as printed.

    State: error quaternion and bias error ``(dq0, dq1, dq2, dq3, db)``, by Runge-Kutta on eq. 13.
    For comparison with the paper; use `UKF` for work. Three things had to be repaired:

    1. Eq. 13 lacks the term ``-dq0 db / 2``; without it the bias is never estimated.
    2. Eq. 14, ``q_star * q_g^-1``, is the error on the inertial side, eq. 9 defines that on the
       body side: the measurement is ``q_g^-1 * q_star``.
    3. The 7x7 covariance is singular along ``dq0``: it starts with a quarter of the attitude
       variance there, and the quaternion is normalised after each step.

    Notes
    -----
    Replays whole logs with star cameras; directions are not used. ``sigma`` and covariances are
    reported as of every filter, for the rotation vector and the bias.

    Examples
    --------
    >>> LiteralUKF().integrator
    'rk4'
    """

    integrator: str = "rk4"
    kind: ClassVar[str] = "literal"


def _check_integrator(value: str) -> None:
    if value not in _INTEGRATORS:
        raise InputError(
            f"must be one of {', '.join(_INTEGRATORS)}", field="filter.integrator", value=value
        )


@dataclass(frozen=True)
class UPF(UKF):
    """Unscented particle filter: an unscented Kalman filter says where to sample, weights the rest.

    Parameters
    ----------
    alpha, beta, kappa
        As of `UKF`.
    integrator : str
        Not used: orbits have steps of their own.
    particles : int
        How many.
    form : {"proposal", "literal", "bank"}
        ``"proposal"`` is the form to use: one `UKF`; particles in antithetic pairs from its result;
        weights likelihood times prior over proposal; the mean is theirs, the covariance the
        `UKF`'s. ``"literal"`` is as printed, a `UKF` for each particle and weights with the
        transition density: it collapses where that is much narrower than the proposal, as in
        orbits. ``"bank"`` is a bank of unscented filters that are weighed by their innovations.
    resampling : {"systematic", "stratified", "residual", "multinomial"}
        How to resample.
    threshold : float
        Resample if fewer than this part of the particles are effective, 0 to 1.
    moves : int
        Metropolis moves of each particle after resampling.
    recover : bool
        Where no particle explains a measurement: whether to go on with what the `UKF` says of it,
        or to raise a `NumericalError` that names the measurement.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    For orbits (`CelestialNavigator`). Van der Merwe, Doucet, de Freitas, Wan, *The unscented
    particle filter*, 2000; Ning and Ma 2010, section 3.3.

    Examples
    --------
    >>> UPF(particles=50).form
    'proposal'
    """

    particles: int = 20
    form: str = "proposal"
    resampling: str = "systematic"
    threshold: float = 0.5
    moves: int = 0
    recover: bool = True
    kind: ClassVar[str] = "upf"

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.form not in FORMS:
            raise InputError(
                f"must be one of {', '.join(FORMS)}", field="filter.form", value=self.form
            )
        _check_particles(self)

    def _setup(self) -> dict[str, Any]:
        return {**super()._setup(), "filter": self.form, "particles": _particles(self)}


@dataclass(frozen=True)
class BootstrapPF:
    """Bootstrap particle filter: particles move by the dynamics and are weighed by the likelihood.

    Parameters
    ----------
    particles : int
        How many.
    resampling : {"systematic", "stratified", "residual", "multinomial"}
        How to resample.
    threshold : float
        Resample if fewer than this part of the particles are effective, 0 to 1.
    recover : bool
        Where no particle explains a measurement: whether to leave it out, or to raise a
        `NumericalError` that names it.
    kernel : bool
        Whether resampled particles are drawn from a smooth density, normal kernels that keep mean
        and covariance (Liu and West 2001), or are copies that only process noise parts.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    For orbits (`CelestialNavigator`). Gordon, Salmond, Smith 1993. Dynamics as good as those of
    orbits leave copies no room to spread: without kernels the filter is soon lost.

    Examples
    --------
    >>> BootstrapPF(particles=500).kind
    'bootstrap'
    """

    particles: int = 1000
    resampling: str = "systematic"
    threshold: float = 0.5
    recover: bool = True
    kernel: bool = True
    kind: ClassVar[str] = "bootstrap"
    moves: ClassVar[int] = 0

    def __post_init__(self) -> None:
        _check_particles(self)

    def _setup(self) -> dict[str, Any]:
        return _setup(self.kind, particles=_particles(self))


def _check_particles(owner: UPF | BootstrapPF) -> None:
    for name, least in (("particles", 1), ("moves", 0)):
        value = getattr(owner, name)
        if number(value, f"filter.{name}", at_least=least) != int(value):
            raise InputError("must be a whole number", field=f"filter.{name}", value=value)
    if owner.resampling not in RESAMPLING:
        raise InputError(
            f"must be one of {', '.join(RESAMPLING)}",
            field="filter.resampling",
            value=owner.resampling,
        )
    if not 0.0 <= number(owner.threshold, "filter.threshold") <= 1.0:
        raise InputError("must be from 0 to 1", field="filter.threshold", value=owner.threshold)


def _particles(owner: UPF | BootstrapPF) -> tuple[int, str, float, int, bool, bool]:
    """Return what the core wants to know of particles."""
    return (
        int(owner.particles),
        owner.resampling,
        float(owner.threshold),
        int(owner.moves),
        bool(owner.recover),
        bool(getattr(owner, "kernel", False)),
    )
