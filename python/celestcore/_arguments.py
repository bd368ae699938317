"""Arguments of `run` and `start`: checked, and turned into what the core takes."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from celestcore._check import QUATERNION_HINT, FloatArray, array, number, quaternion, unit_rows
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

Sigma0: TypeAlias = "tuple[ArrayLike, ArrayLike]"
LARGEST = 1e50
"""Beyond it a 1-sigma is a mistake, and its square soon no number."""


def named(sensors: Mapping[str, Any], name: str, what: str) -> Any:
    if name in sensors:
        return sensors[name]
    known = ", ".join(sensors) or "none"
    raise InputError(f"no {what} sensor is described for it; described are {known}", field=name)


def checked(value: Any, field: str, *kinds: type) -> Any:
    if isinstance(value, kinds):
        return value
    known = " or ".join(f"{kind.__name__}(...)" for kind in kinds)
    shown = value if isinstance(value, str | int | float) else type(value).__name__
    raise InputError(f"must be {known}", field=field, value=shown)


def each_checked(value: Any, field: str, kind: type) -> Any:
    """Check one sensor, or a mapping of names to sensors."""
    if not isinstance(value, Mapping):
        return checked(value, field, kind)
    return {name: checked(sensor, str(name), kind) for name, sensor in value.items()}


def one_quaternion(q: QuaternionLike, field: str) -> tuple[float, ...]:
    """Return one unit quaternion; rounding is normalised, what is further off is an error."""
    value = quaternion(q, field)
    if value.size != 4:
        raise InputError(f"needs one quaternion, got shape {value.shape}", field=field)
    rows = value.reshape(1, 4)
    if not np.isfinite(rows).all():
        raise InputError("must be finite", field=field, value=rows[0])
    try:
        unit_rows(rows, field, what="quaternion", hint=QUATERNION_HINT)
    except InputError as error:
        error.row = None
        raise
    return tuple(rows[0].tolist())


def three(value: ArrayLike, field: str) -> list[float]:
    """Return three finite numbers of one or three."""
    a = array(value, field)
    if a.shape not in ((), (1,), (3,)) or not np.all(np.isfinite(a)):
        raise InputError("needs one finite number or three", field=field, value=a.tolist())
    return [float(x) for x in np.broadcast_to(a, (3,))]


def count(value: int, field: str) -> int:
    n = number(value, field)
    if n != np.floor(n) or n < 1.0:
        raise InputError("must be a whole number of at least 1", field=field, value=value)
    return int(min(n, 2.0**53))


def positive(value: ArrayLike, field: str) -> FloatArray:
    """Return three 1-sigma values of one or three."""
    sigma = np.array(three(value, field))
    if not np.all((sigma > 0.0) & (sigma < LARGEST)):
        raise InputError(f"must be positive and below {LARGEST:g}", field=field, value=sigma)
    return sigma


def sigma_of(sigma0: Sigma0) -> FloatArray:
    """Return the start's 1-sigma values (6,): attitude [rad], bias [rad/s]."""
    pair = isinstance(sigma0, Sequence) or (isinstance(sigma0, np.ndarray) and sigma0.ndim > 0)
    if not pair or len(sigma0) != 2:
        raise InputError("needs (attitude [rad], bias [rad/s])", field="sigma0", value=sigma0)
    return np.concatenate([positive(part, "sigma0") for part in sigma0])


def covariance_of(sigma0: Sigma0 | None, covariance0: ArrayLike | None) -> FloatArray:
    """Return the start's covariance (6, 6), of 1-sigma values or as it is given."""
    if covariance0 is not None:
        if sigma0 is not None:
            raise InputError("give sigma0 or covariance0, not both", field="covariance0")
        p = array(covariance0, "covariance0", (6, 6))
        if not (np.isfinite(p).all() and np.allclose(p, p.T, rtol=1e-9, atol=0.0)):
            raise InputError("must be finite and symmetric", field="covariance0", value=p)
        return np.ascontiguousarray(0.5 * (p + p.T))
    if sigma0 is None:
        raise InputError(
            "is needed with q0: (attitude [rad], bias [rad/s]); or give covariance0",
            field="sigma0",
        )
    sigma = sigma_of(sigma0)
    with np.errstate(over="ignore"):  # the core refuses what is not finite
        return np.diag(sigma * sigma)


def processors(threads: int | None, *, alone: bool) -> int:
    """Return the number of threads: all processors, or one for each task of an executor."""
    if threads is not None:
        return count(threads, "threads")
    if not alone:
        return 1
    if hasattr(os, "sched_getaffinity"):  # what this process may use, in a container too
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
