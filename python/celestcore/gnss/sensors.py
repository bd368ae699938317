"""What a GNSS and star navigator is told of its sensors."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore._arguments import positive, three
from celestcore._check import FloatArray, array, number
from celestcore.errors import InputError
from celestcore.units import ARCSEC

__all__ = ["GaussMarkov", "GnssReceiver", "KinematicAttitude", "LowFrequencyError"]

MOST_HARMONICS = 2
"""Harmonics that the core has filters for."""


@dataclass(frozen=True)
class GaussMarkov:
    """An error that fades: ``db/dt = -b / tau + noise``, the same in each of three axes.

    Parameters
    ----------
    sigma : float
        Stationary 1-sigma per axis, in the unit of what it is an error of.
    tau : float
        Correlation time [s].

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> GaussMarkov(1.0, 1800.0)
    GaussMarkov(sigma=1.0, tau=1800.0)
    """

    sigma: float
    tau: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma", number(self.sigma, "sigma", above=0.0))
        object.__setattr__(self, "tau", number(self.tau, "tau", above=0.0))


@dataclass(frozen=True)
class GnssReceiver:
    """A receiver that gives positions, and velocities if they are used, in the Earth-fixed frame.

    Parameters
    ----------
    sigma : float or array_like (3,)
        1-sigma noise of positions along the Earth-fixed axes [m].
    sigma_velocity : float or array_like (3,), optional
        The same of velocities [m/s]; None: velocities are not used.
    lever_arm : array_like (3,)
        Antenna from the centre of mass, body frame [m].
    time_offset : float
        What the time tags are ahead of the log's time [s]: it is subtracted.
    bias : GaussMarkov, optional
        A slow error of the positions [m], estimated along the inertial axes.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> GnssReceiver(10.0, 0.1, bias=GaussMarkov(1.0, 1800.0)).lever_arm
    (0.0, 0.0, 0.0)
    """

    sigma: ArrayLike = 1.0
    sigma_velocity: ArrayLike | None = 0.01
    _: KW_ONLY
    lever_arm: ArrayLike = (0.0, 0.0, 0.0)
    time_offset: float = 0.0
    bias: GaussMarkov | None = None

    def __post_init__(self) -> None:
        def put(name: str, value: Any) -> None:
            object.__setattr__(self, name, value)

        put("sigma", tuple(positive(self.sigma, "gnss.sigma").tolist()))
        if self.sigma_velocity is not None:
            velocity = positive(self.sigma_velocity, "gnss.sigma_velocity")
            put("sigma_velocity", tuple(velocity.tolist()))
        arm = array(self.lever_arm, "gnss.lever_arm", (3,))
        if not np.isfinite(arm).all() or np.linalg.norm(arm) > 1e3:
            raise InputError(
                "must be finite, and below a kilometre: it is in metres",
                field="gnss.lever_arm",
                value=arm,
            )
        put("lever_arm", tuple(three(arm, "gnss.lever_arm")))
        put("time_offset", number(self.time_offset, "gnss.time_offset"))
        if self.bias is not None and not isinstance(self.bias, GaussMarkov):
            raise InputError("must be GaussMarkov(...)", field="gnss.bias", value=self.bias)


@dataclass(frozen=True)
class LowFrequencyError:
    """The slow error of a star sensor: harmonics of the orbit, and an error that fades.

    The sensor reports ``q = q_true (x) exp(b/2)`` with a rotation vector in the body frame
    ``b(t) = sum_k c_k cos(k n t) + s_k sin(k n t) + g(t)``; t counts from the log's epoch.

    Parameters
    ----------
    amplitudes : array_like
        Expected amplitude of each harmonic [rad], the first at the orbit's frequency: coefficients
        c_k and s_k are taken as normal with 1-sigma ``amplitude / sqrt(2)`` in each axis. Two at
        most.
    period : float, optional
        Period of the first harmonic [s]; the orbit's own by default.
    gauss_markov : GaussMarkov, optional
        An error that fades, g [rad].

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> import celestcore as cc
    >>> LowFrequencyError((10 * cc.ARCSEC, 3 * cc.ARCSEC)).vectors
    4
    """

    amplitudes: ArrayLike = (10.0 * ARCSEC, 3.0 * ARCSEC)
    period: float | None = None
    gauss_markov: GaussMarkov | None = None

    def __post_init__(self) -> None:
        given = array(self.amplitudes, "lfe.amplitudes").reshape(-1)
        if len(given) > MOST_HARMONICS:
            raise InputError(
                f"are {len(given)}; {MOST_HARMONICS} harmonics at most are estimated, and a "
                "GaussMarkov error can hold what lies beside them",
                field="lfe.amplitudes",
            )
        each = tuple(number(a, "lfe.amplitudes", above=0.0) for a in given.tolist())
        object.__setattr__(self, "amplitudes", each)
        if self.period is not None:
            object.__setattr__(self, "period", number(self.period, "lfe.period", above=0.0))
        if self.gauss_markov is not None and not isinstance(self.gauss_markov, GaussMarkov):
            raise InputError("must be GaussMarkov(...)", field="lfe.gauss_markov")
        if not each and self.gauss_markov is None:
            raise InputError(
                "estimates nothing: give amplitudes or gauss_markov, or lfe=None", field="lfe"
            )

    @property
    def harmonics(self) -> int:
        """How many harmonics there are."""
        return len(np.atleast_1d(self.amplitudes))

    @property
    def vectors(self) -> int:
        """How many vectors of three the filter estimates for it."""
        return 2 * self.harmonics + (self.gauss_markov is not None)

    @property
    def names(self) -> list[str]:
        """What the vectors are: ``cos 1``, ``sin 1`` ... and ``gauss-markov``."""
        out = [f"{part} {k + 1}" for k in range(self.harmonics) for part in ("cos", "sin")]
        return out + ["gauss-markov"] * (self.gauss_markov is not None)

    @property
    def prior(self) -> FloatArray:
        """1-sigma of each vector's components before any fix [rad], shape (vectors,)."""
        each: FloatArray = np.repeat(np.atleast_1d(self.amplitudes), 2) / np.sqrt(2.0)
        if self.gauss_markov is None:
            return each
        return np.append(each, self.gauss_markov.sigma)

    def weights(self, t: FloatArray, period: float) -> FloatArray:
        """Return how much each vector adds to the error at times t.

        Parameters
        ----------
        t : ndarray (n,)
            [s since the epoch].
        period : float
            Of the first harmonic [s].

        Returns
        -------
        ndarray (n, vectors)

        Examples
        --------
        >>> LowFrequencyError((1e-5,)).weights(np.array([0.0]), 6000.0)
        array([[1., 0.]])
        """
        phase = (2.0 * np.pi / period) * t
        columns = [
            part((k + 1) * phase) for k in range(self.harmonics) for part in (np.cos, np.sin)
        ]
        if self.gauss_markov is not None:
            columns.append(np.ones(len(t)))
        return np.ascontiguousarray(np.stack(columns, axis=1))

    def _tail(self) -> list[tuple[float, float]]:
        """Sigma and fading rate of each vector, as the core takes them."""
        tail = [(0.0, 0.0)] * (2 * self.harmonics)
        if self.gauss_markov is not None:
            tail.append((self.gauss_markov.sigma, 1.0 / self.gauss_markov.tau))
        return tail


@dataclass(frozen=True)
class KinematicAttitude:
    """A body without a gyro: its angular jerk about the orbital frame is white noise.

    Parameters
    ----------
    jerk_psd : float
        Power spectral density of the jerk per axis [rad^2/s^5]. Against star fixes of 1-sigma R
        every T seconds the filter averages over about ``(R^2 T / jerk_psd)^(1/6)`` seconds.
    rate_sigma : float
        1-sigma of the rate at the start [rad/s].
    acceleration_sigma : float
        1-sigma of the angular acceleration at the start [rad/s^2].

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> KinematicAttitude().jerk_psd
    1e-16
    """

    jerk_psd: float = 1e-16
    rate_sigma: float = 1e-2
    acceleration_sigma: float = 1e-4

    def __post_init__(self) -> None:
        for name in ("jerk_psd", "rate_sigma", "acceleration_sigma"):
            value = number(getattr(self, name), f"attitude.{name}", above=0.0)
            object.__setattr__(self, name, value)
