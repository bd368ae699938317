"""Checks of what comes in from outside: convert, verify, and name the field, row and value."""

from __future__ import annotations

import functools
import sys
import warnings
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore.errors import CelestcoreWarning, InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

NORM_TOLERANCE = 1e-3
"""How far the norm of a quaternion or unit vector may be from 1 before it is an error."""
_NORM_ROUNDING = 8.0 * float(np.finfo(np.float64).eps)
_SYMMETRY_TOLERANCE = 1e-8


def warn(message: str) -> None:
    """Warn at the line of the caller outside celestcore."""
    level, frame = 1, sys._getframe()
    while frame.f_back is not None and _is_ours(frame.f_globals.get("__package__")):
        level, frame = level + 1, frame.f_back
    warnings.warn(message, CelestcoreWarning, stacklevel=level)


def _is_ours(package: str | None) -> bool:
    return (package or "").partition(".")[0] == (__package__ or "").partition(".")[0]


def array(
    value: Any, field: str, shape: Sequence[int | None] | None = None, *, copy: bool = True
) -> FloatArray:
    """Copy anything array-like to a fresh C-ordered float64 array.

    Parameters
    ----------
    value : array_like
        Numbers of any real dtype, byte order and memory layout. Masked entries, ``None`` and
        pandas' ``NA`` become NaN.
    field : str
        The name that messages use.
    shape : sequence of int or None, optional
        The shape that is needed; None stands for any length.
    copy : bool
        Whether an array that is already as it should be is copied.

    Returns
    -------
    ndarray
        float64, C order, sharing no memory with `value` unless `copy` is false.

    Raises
    ------
    InputError
        If it holds no real numbers or has another shape.

    Examples
    --------
    >>> array([[1, 2, 3]], "gyro.rate", (None, 3))
    array([[1., 2., 3.]])
    """
    plain = type(value) is np.ndarray and value.dtype == np.float64 and value.flags.c_contiguous
    out = value if plain and not copy else _numbers(value, field)
    if shape is not None:
        _check_shape(out, field, tuple(shape))
    return out


def _numbers(value: Any, field: str) -> FloatArray:
    mask = np.ma.getmaskarray(value) if isinstance(value, np.ma.MaskedArray) else None
    try:
        raw = np.asarray(value)
    except (TypeError, ValueError) as error:
        raise InputError(
            f"cannot be made an array ({error}); all rows need the same number of columns",
            field=field,
        ) from None
    if raw.dtype.kind == "O":
        out = _from_objects(raw, field)
    elif raw.dtype.kind in "fiu":
        out = np.array(raw, dtype=np.float64, order="C", copy=True)
    else:
        raise InputError(
            f"holds {raw.dtype.name}, not real numbers"
            + ("; give float seconds since the log's epoch" if raw.dtype.kind in "mM" else ""),
            field=field,
            value=raw.flat[0] if raw.size else None,
        )
    if mask is not None and mask.any():
        out[mask] = np.nan
    return out


def _from_objects(raw: NDArray[Any], field: str) -> FloatArray:
    out = np.empty(raw.shape, dtype=np.float64)
    flat = out.reshape(-1)
    for k, item in enumerate(raw.flat):
        if item is None or type(item).__name__ == "NAType":
            flat[k] = np.nan
            continue
        try:
            if isinstance(item, str | bytes | bool):
                raise TypeError("not a number")
            flat[k] = float(item)
        except (TypeError, ValueError, OverflowError):
            row = int(np.unravel_index(k, raw.shape)[0]) if raw.ndim else None
            raise InputError(
                "is not a real number (use None or NaN where a measurement is missing)",
                field=field,
                row=row,
                value=item,
            ) from None
    return out


def _check_shape(out: FloatArray, field: str, shape: tuple[int | None, ...]) -> None:
    same = len(shape) == out.ndim and all(
        want is None or want == got for want, got in zip(shape, out.shape, strict=True)
    )
    if same:
        return
    names = iter(["n", "m", "k"])
    wanted = ", ".join(next(names) if s is None else str(s) for s in shape)
    wanted += "," if len(shape) == 1 else ""
    hint = ""
    if len(shape) == 2 and shape[0] is None and out.ndim == 2 and out.shape[0] == shape[1]:
        hint = "; transpose it"
    elif out.ndim == len(shape) - 1 and shape[0] is None:
        hint = "; give one row per sample, also for a single one"
    raise InputError(f"has shape {out.shape}, needed is ({wanted}){hint}", field=field)


def number(
    value: Any, field: str, *, above: float | None = None, at_least: float | None = None
) -> float:
    """Return one finite number, or raise an `InputError` that names the field.

    Examples
    --------
    >>> number(np.float32(2), "gyro.arw", above=0.0)
    2.0
    """
    out = array(value, field)
    if out.size != 1:
        raise InputError(f"must be one number, not an array of shape {out.shape}", field=field)
    result = float(out.reshape(-1)[0])
    if not np.isfinite(result):
        raise InputError("must be finite", field=field, value=result)
    if above is not None and not result > above:
        raise InputError(f"must be greater than {above:g}", field=field, value=result)
    if at_least is not None and not result >= at_least:
        raise InputError(f"must be at least {at_least:g}", field=field, value=result)
    return result


def times(value: Any, field: str, *, copy: bool = True) -> FloatArray:
    """Return times [s] (n,), n > 0, finite and strictly increasing.

    Raises
    ------
    InputError
        Names the first row that is empty, not finite, repeated or going back.
    """
    t = array(value, field, (None,), copy=copy)
    if t.size == 0:
        raise InputError("is empty; leave the sensor out if it has no samples", field=field)
    if bool((t[1:] > t[:-1]).all()) and bool(np.isfinite(t[0]) and np.isfinite(t[-1])):
        if abs(t[-1]) > 1e9:
            warn(
                f"{field} reaches {t[-1]:.17g} s: give seconds since the log's epoch, not since "
                "1970; so far from zero a float64 resolves no more than 0.1 microseconds"
            )
        return t
    bad = ~np.isfinite(t)
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError(
            "a time must be finite; drop the row or repair its time",
            field=field,
            row=row,
            value=t[row],
        )
    row = 1 + int(np.argmax(t[1:] <= t[:-1]))
    before = f"row {row - 1} ({float(t[row - 1])!r})"
    what = f"repeats {before}" if t[row] == t[row - 1] else f"goes back, it is before {before}"
    raise InputError(
        f"{what}; times must increase: sort the rows by time and drop repeated ones",
        field=field,
        row=row,
        value=t[row],
    )


def finite_rows(*arrays: FloatArray) -> BoolArray | None:
    """Say which rows are finite in every array; None if all are (the usual case, one fast pass)."""
    with np.errstate(all="ignore"):
        if all(np.isfinite(a.sum()) for a in arrays):
            return None
    good = np.ones(len(arrays[0]), dtype=bool)
    for a in arrays:
        good &= _all_in_row(np.isfinite(a))
    return None if bool(good.all()) else good


def _all_in_row(good: BoolArray) -> BoolArray:
    columns = list(good.reshape(len(good), -1).T)  # faster than all(axis=1) for few columns
    return np.asarray(functools.reduce(np.logical_and, columns))


def _first(bad: BoolArray, rows: IntArray | None) -> tuple[int, int]:
    k = int(np.argmax(bad))
    return k, k if rows is None else int(rows[k])


def unit_rows(
    v: FloatArray, field: str, *, what: str, hint: str, rows: IntArray | None = None
) -> FloatArray:
    """Normalise rows (n, k) in place; an error if a norm is off by more than `NORM_TOLERANCE`.

    Rows that are unit to rounding are left as they are, so doing it twice changes nothing.
    """
    n2 = np.einsum("ij,ij->i", v, v)
    rounding = ~(np.abs(n2 - 1.0) <= _NORM_ROUNDING)
    if rounding.any():
        norm = np.sqrt(n2)
        _check_norm(v, norm, field, what, hint, rows)
        v[rounding] /= norm[rounding, None]
    return v


def _check_norm(
    v: FloatArray, norm: FloatArray, field: str, what: str, hint: str, rows: IntArray | None
) -> None:
    bad = ~(np.abs(norm - 1.0) <= NORM_TOLERANCE)
    if not bad.any():
        return
    k, row = _first(bad, rows)
    if norm[k] == 0.0:
        message = f"is zero, which is no {what}; drop the row, or write NaN if it is missing"
    else:
        message = f"has norm {norm[k]:.6g} where a unit {what} is needed; {hint}"
    raise InputError(message, field=field, row=row, value=v[k])


def directions(v: FloatArray, field: str) -> FloatArray:
    """Scale vectors (n, 3) by powers of two so that no square over- or underflows.

    Raises
    ------
    InputError
        Names the first row that is zero or not finite.
    """
    largest = np.abs(v).max(axis=1, initial=0.0)
    bad = ~((largest > 0.0) & np.isfinite(largest))
    if bad.any():
        row = int(np.argmax(bad))
        raise InputError("has no direction", field=field, row=row, value=v[row])
    return np.asarray(np.ldexp(v, -np.frexp(largest)[1][:, None]))


def quaternion(value: Any, field: str, *, scalar_first: bool = True) -> FloatArray:
    """Return unrestricted quaternions (..., 4), scalar first, of an array or a scipy Rotation."""
    as_quat = getattr(value, "as_quat", None)
    if callable(as_quat):
        value, scalar_first = as_quat(), False
    q = array(value, field)
    if q.ndim == 0 or q.shape[-1] != 4:
        raise InputError(f"has shape {q.shape}, needed are 4 columns (w, x, y, z)", field=field)
    return q if scalar_first else np.ascontiguousarray(q[..., [3, 0, 1, 2]])


QUATERNION_HINT = (
    "check that the columns are w, x, y, z (scalar_first=False for x, y, z, w) and normalise them"
)


def mounting(value: Any, field: str) -> tuple[float, float, float, float] | None:
    """Return a mounting quaternion as a plain tuple (w, x, y, z), or None for no mounting."""
    if value is None:
        return None
    q = quaternion(value, field).reshape(-1, 4)
    if len(q) != 1:
        raise InputError(f"must be one quaternion, not {len(q)}", field=field)
    if not np.isfinite(q).all():
        raise InputError("must be finite", field=field, value=q[0])
    try:
        unit_rows(q, field, what="quaternion", hint=QUATERNION_HINT)
    except InputError as error:
        error.row = None
        raise
    w, x, y, z = q[0].tolist()
    return (w, x, y, z)


def sigmas(
    value: Any, field: str, shape: tuple[int, ...], *, rows: IntArray | None = None
) -> FloatArray:
    """Return finite positive 1-sigma noise of this shape."""
    sigma = array(value, field, shape)
    bad = ~(np.isfinite(sigma) & (sigma > 0.0))
    if bad.any():
        k, row = _first(~_all_in_row(~bad), rows)
        raise InputError(
            "noise must be finite and positive; write NaN in the measurement if it is missing",
            field=field,
            row=row,
            value=sigma[k],
        )
    return sigma


def covariances(
    value: Any, field: str, n: int, *, rows: IntArray | None = None, one: bool = False
) -> FloatArray:
    """Return (n, 3, 3) noise covariances: finite, symmetric (made exactly so), positive definite.

    With `one` the messages name no row: the covariance is not per sample.
    """
    c = array(value, field, (n, 3, 3))

    def fail(bad: BoolArray, message: str) -> None:
        if bad.any():
            k, row = _first(bad, rows)
            raise InputError(message, field=field, row=None if one else row, value=c[k])

    e = np.ascontiguousarray(c.reshape(n, 9).T)  # the nine elements, one row each
    fail(~_all_in_row(np.isfinite(c)), "noise must be finite")
    lower, upper = e[[3, 6, 7]], e[[1, 2, 5]]
    if not np.array_equal(lower, upper):
        skew = np.abs(lower - upper).max(axis=0) > _SYMMETRY_TOLERANCE * np.abs(e).max(axis=0)
        fail(skew, "a noise covariance must be symmetric; use (C + C.T) / 2 if it nearly is")
        transposed = c.transpose(0, 2, 1)
        c = np.where(c == transposed, c, 0.5 * c + 0.5 * transposed)
        e = np.ascontiguousarray(c.reshape(n, 9).T)
    xx, xy, xz, yy, yz, zz = e[[0, 1, 2, 4, 5, 8]]
    with np.errstate(all="ignore"):
        d1 = yy - xy * (xy / xx)
        d2 = zz - xz * (xz / xx)
        rest = yz - xy * (xz / xx)
        d2 -= rest * (rest / d1)
    fail(~((xx > 0.0) & (d1 > 0.0) & (d2 > 0.0)), "a noise covariance must be positive definite")
    return c
