"""Where a spacecraft's GPS antennas are, and what attitude accuracy they promise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import BoolArray, FloatArray, array, number
from celestcore.errors import InputError

__all__ = ["Antennas", "predict_attitude_sigma"]

SIGMA = 0.005
"""1-sigma error of a carrier-phase baseline per axis [m], unless told otherwise."""
_DEGENERATE = 1e-12
_AXES = ("x", "y", "z")


@dataclass(frozen=True, eq=False)
class Antennas:
    """Vectors from a master antenna to the others, in the body frame.

    Parameters
    ----------
    baselines : array_like (n, 3)
        From the master antenna to each other one [m], body frame; two or more, not on one line.
    sigma : float
        1-sigma error of a measured baseline about each axis [m]. Carrier phases give some 5 mm,
        differences of code positions metres.
    shared_master : bool
        All baselines start at the same antenna. Its error is in all of them, so that two have the
        covariance ``sigma^2 / 2`` per axis; otherwise their errors are independent.

    Attributes
    ----------
    baselines : ndarray (n, 3)
        [m], body frame, a copy.

    Raises
    ------
    InputError
        If there are fewer than two baselines or all are on one line: the message names the body
        axis about which no turn is seen. If a baseline is zero, or the sigma is not positive.

    Examples
    --------
    >>> antennas = Antennas([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]])
    >>> antennas.covariance
    array([[2.50e-05, 1.25e-05],
           [1.25e-05, 2.50e-05]])
    >>> Antennas([[2.0, 0.0, 0.0], [-1.0, 0.0, 0.0]])
    Traceback (most recent call last):
    ...
    celestcore.errors.InputError: antennas.baselines, value (1.0, 0.0, 0.0): ...axis x...
    """

    baselines: FloatArray
    sigma: float = SIGMA
    shared_master: bool = True

    def __post_init__(self) -> None:
        b = array(self.baselines, "antennas.baselines", (None, 3))
        _check(b)
        object.__setattr__(self, "baselines", b)
        object.__setattr__(self, "sigma", number(self.sigma, "antennas.sigma", above=0.0))
        object.__setattr__(self, "shared_master", bool(self.shared_master))

    def __len__(self) -> int:
        """Return how many baselines there are."""
        return len(self.baselines)

    @property
    def lengths(self) -> FloatArray:
        """Lengths of the baselines [m], (n,).

        Examples
        --------
        >>> Antennas([[3.0, 4.0, 0.0], [0.0, 1.5, 0.0]]).lengths
        array([5. , 1.5])
        """
        return np.asarray(np.linalg.norm(self.baselines, axis=1))

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the measured baselines about each axis [m^2], (n, n).

        The errors about different axes are independent and alike in all frames.

        Examples
        --------
        >>> Antennas(np.eye(3), sigma=0.1, shared_master=False).covariance.round(3)
        array([[0.01, 0.  , 0.  ],
               [0.  , 0.01, 0.  ],
               [0.  , 0.  , 0.01]])
        """
        n = len(self.baselines)
        own = np.eye(n)
        return self.sigma**2 * (0.5 * (own + 1.0) if self.shared_master else own)


def predict_attitude_sigma(
    antennas: Antennas | ArrayLike, *, sigma: float = SIGMA, shared_master: bool = True
) -> FloatArray:
    """Predict the attitude error that a layout of antennas promises, before any is built.

    Parameters
    ----------
    antennas : Antennas or array_like (n, 3)
        The layout, or just its baselines [m], body frame.
    sigma, shared_master
        As in `Antennas`; only for plain baselines, an `Antennas` brings its own.

    Returns
    -------
    ndarray (3,)
        1-sigma error about the body axes x, y, z [rad].

    Raises
    ------
    InputError
        As `Antennas`.

    Notes
    -----
    Roots of the diagonal of the inverse of ``sum(W_ij [b_i]x^T [b_j]x)``, ``W`` the inverse of
    `Antennas.covariance`: what `gps_attitude` reaches while the errors are small against the
    baselines. The direct method on one baseline of length L gets ``sigma / L`` in pitch and
    ``sigma / (L cos(pitch))`` in yaw.

    Examples
    --------
    >>> predict_attitude_sigma([[2.0, 0.0, 0.0], [0.0, 1.5, 0.0]]).round(5)  # rad
    array([0.00333, 0.0025 , 0.00173])
    """
    if not isinstance(antennas, Antennas):
        antennas = Antennas(array(antennas, "antennas.baselines"), sigma, shared_master)
    weights = np.asarray(np.linalg.inv(antennas.covariance))
    p = np.asarray(np.linalg.inv(information(antennas.baselines, weights)))
    return np.asarray(np.sqrt(np.diagonal(p)))


def cross_matrix(v: FloatArray) -> FloatArray:
    """Return the matrices [v]x (..., 3, 3) of ``v x u = [v]x u``."""
    x, y, z = np.moveaxis(v, -1, 0)
    zero = np.zeros_like(x)
    rows = ((zero, -z, y), (z, zero, -x), (-y, x, zero))
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def information(baselines: FloatArray, weights: FloatArray) -> FloatArray:
    """Return ``sum(W_ij [b_i]x^T [b_j]x)`` (..., 3, 3) [1/rad^2] of weights (..., n, n) [1/m^2]."""
    # [a]x^T [b]x = (a . b) I - b a^T
    moment = np.einsum("...ij,ia,jb->...ab", weights, baselines, baselines)
    trace = np.trace(moment, axis1=-2, axis2=-1)
    return np.asarray(trace[..., None, None] * np.eye(3) - np.swapaxes(moment, -1, -2))


def observable(baselines: FloatArray, used: BoolArray) -> BoolArray:
    """Say which subsets (..., n) of baselines leave no turn free: two of them not on one line."""
    weights = used[..., None] * np.eye(len(baselines))
    spread = np.linalg.eigvalsh(information(baselines, weights))
    return np.asarray(spread[..., 0] > _DEGENERATE * spread[..., 2])


def _check(b: FloatArray) -> None:
    bad = ~(np.isfinite(b).all(axis=1) & b.any(axis=1))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "must be finite and not zero", field="antennas.baselines", row=row, value=b[row]
        )
    if len(b) == 0:
        raise InputError(
            "no baselines: no turn about any body axis x, y, z is observable; give two or more",
            field="antennas.baselines",
        )
    if not observable(b, np.ones(len(b), dtype=bool)):
        raise _collinear(b)


def _collinear(b: FloatArray) -> InputError:
    axis = b[0] / np.linalg.norm(b[0])
    largest = int(np.argmax(np.abs(axis)))
    axis = axis * np.sign(axis[largest]) + 0.0
    near = np.abs(axis[largest]) > 1.0 - 1e-12
    name = f"the body axis {_AXES[largest]}" if near else "this body axis"
    what = "one baseline leaves"
    if len(b) > 1:
        what = f"the {len(b)} baselines are on one line and leave"
    return InputError(
        f"{what} the turn about {name} unobservable: add one across it",
        field="antennas.baselines",
        value=axis.round(6) + 0.0,
    )
