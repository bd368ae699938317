"""Whether a filter's errors are as large as it says: NEES and NIS over many trials."""

from __future__ import annotations

from dataclasses import dataclass

import celestcore as cc
import numpy as np
from scipy.stats import chi2
from simulate import FloatArray, Trials, local


@dataclass(frozen=True)
class Measured:
    """Errors of all trials at the epochs, and all innovations."""

    error: FloatArray
    """True less estimated error state (trials, epochs, 6) [rad], [rad/s]."""
    covariance: FloatArray
    """What the filter says of it (trials, epochs, 6, 6)."""
    nis: dict[int, FloatArray]
    """By degrees of freedom: (trials, measurements)."""

    @property
    def nees(self) -> FloatArray:
        """Of all six components (trials, epochs)."""
        return quadratic(self.error, self.covariance)

    @property
    def nees_attitude(self) -> FloatArray:
        """Of the attitude alone, three components."""
        return quadratic(self.error[..., :3], self.covariance[..., :3, :3])

    def whitened(self) -> FloatArray:
        """Errors in units of their own covariance (trials, epochs, 6)."""
        root = np.linalg.cholesky(self.covariance)
        return np.linalg.solve(root, self.error[..., None])[..., 0]

    def rms(self) -> FloatArray:
        """Of each component, over trials and epochs (6,)."""
        return np.sqrt(np.mean(self.error**2, axis=(0, 1)))


def quadratic(error: FloatArray, covariance: FloatArray) -> FloatArray:
    """Return the squared length of errors in units of their covariance."""
    solved = np.linalg.solve(covariance, error[..., None])[..., 0]
    return np.sum(error * solved, axis=-1)


def measure(trials: Trials, filter: cc.EKF | cc.UKF, spacing: int) -> Measured:  # noqa: A002
    """Run one filter over all trials; epochs are `spacing` gyro samples apart."""
    navigator = trials.navigator(filter)
    error, covariance, nis, dof = [], [], [], np.zeros(0)
    for trial in range(len(trials)):
        sol = trials.run(navigator, trial, every=spacing)
        assert sol.covariance is not None
        assert sol.counts["accepted"] == sol.counts["fixes"]
        at = slice(None, None, spacing)
        turn = local(sol.q, trials.q[trial, at])
        error.append(np.concatenate([turn, trials.bias[trial, at] - sol.bias], axis=-1))
        covariance.append(sol.covariance)
        nis.append(sol.nis)
        dof = sol.dof
    every = np.array(nis)
    return Measured(
        error=np.array(error),
        covariance=np.array(covariance),
        nis={int(d): every[:, dof == d] for d in np.unique(dof)},
    )


def bounds(probability: float, dof: int, count: int) -> tuple[float, float]:
    """Return what the mean of `count` chi-square numbers stays within at this probability."""
    low, high = chi2.ppf([0.5 - 0.5 * probability, 0.5 + 0.5 * probability], dof * count) / count
    return float(low), float(high)


def inside(value: FloatArray, within: tuple[float, float]) -> FloatArray:
    return (value > within[0]) & (value < within[1])


def level(values: FloatArray, dof: int) -> float:
    """Return the probability of a smaller mean than that of these chi-square numbers."""
    return float(chi2.cdf(values.sum(), dof * values.size))
