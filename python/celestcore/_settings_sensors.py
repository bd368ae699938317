"""Sensors from their tables of settings."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from celestcore.errors import InputError
from celestcore.sensors import Gyro, StarCamera, VectorSensor


def gyro(values: Mapping[str, Any]) -> Gyro:
    """Return the gyro of ``[gyro]``."""
    options = dict(values)
    if "max_gap_s" in options:
        options["max_gap"] = options.pop("max_gap_s")
    return Gyro(**options)


def star(name: str, values: Mapping[str, Any]) -> StarCamera:
    """Return the star camera of ``[star_NAME]``; errors name that table."""
    try:
        return StarCamera(**{k: v for k, v in values.items() if k != "time_offset"})
    except InputError as error:
        raise _renamed(error, "star", name) from None


def vector(name: str, values: Mapping[str, Any]) -> VectorSensor:
    """Return the direction sensor of ``[vector_NAME]``; errors name that table."""
    try:
        return VectorSensor(**values)
    except InputError as error:
        raise _renamed(error, "vector", name) from None


def _renamed(error: InputError, kind: str, name: str) -> InputError:
    if error.field is not None:
        error.field = name + error.field.removeprefix(kind)
    return error
