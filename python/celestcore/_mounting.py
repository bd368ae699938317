"""How a sensor's mounting turns its rates, directions and noise to the body frame."""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from celestcore._check import FloatArray

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

_PACKED = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def matrix_of(q: QuaternionLike) -> FloatArray:
    """Return the matrix (3, 3) of a quaternion."""
    from celestcore.quaternion import to_matrix

    return np.asarray(to_matrix(np.asarray(q, dtype=np.float64)))


def turned(turn: FloatArray, v: FloatArray) -> FloatArray:
    """Return vectors (..., 3) turned by a matrix, to the bits of the core.

    Term by term as there: a matrix product may round differently.
    """
    x, y, z = (turn[:, k] * v[..., k : k + 1] for k in range(3))
    return np.ascontiguousarray(x + y + z)


@lru_cache(maxsize=64)
def packed_rotation(mounting: tuple[float, ...] | None) -> FloatArray:
    """Return the matrix (9, 6) from the elements of C to those of R C R^T, packed."""
    turn = np.eye(3) if mounting is None else matrix_of(mounting)
    return np.stack([np.outer(turn[i], turn[j]).reshape(9) for i, j in _PACKED], axis=1)
