"""The navigator that ``[gnss]``, ``[orbit]``, ``[attitude]`` and ``[lfe]`` describe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from celestcore._check import number
from celestcore._tables import table_kind
from celestcore.errors import InputError

if TYPE_CHECKING:
    from celestcore.config import Settings
    from celestcore.gnss import (
        GaussMarkov,
        GnssReceiver,
        GnssStarNavigator,
        KinematicAttitude,
        LowFrequencyError,
    )
    from celestcore.orbit import OrbitDynamics

TABLES = ("gnss", "orbit", "attitude", "lfe")
FILTERS = ("ekf", "ukf")
FIELDS = ("JGM-3", "EGM2008")
GATE = 0.9999
"""What a good fix passes with unless ``[gate]`` says otherwise: an orbit filter needs a gate."""
_ONLY_ATTITUDE = ("integrator",)


def check(tables: Mapping[str, Mapping[str, Any]]) -> None:
    """Let the descriptions check their own values."""
    if "gnss" in tables:
        receiver({"sigma": 1.0, **tables["gnss"]})
        _max_rejected(tables["gnss"])
    for name, build in (("orbit", dynamics), ("attitude", kinematic), ("lfe", slow_error)):
        if name in tables:
            build(tables[name])
    for name, values in tables.items():
        if table_kind(name) == "star" and "time_offset" in values:
            number(values["time_offset"], f"{name}.time_offset")


def navigator(settings: Settings, *, gyro: bool) -> GnssStarNavigator:
    """Return the navigator; see `Settings.gnss_navigator`."""
    from celestcore.gnss import GnssStarNavigator
    from celestcore.sensors import StarCamera

    tables = settings.tables
    own = tables.get("gnss", {})
    if "sigma" not in own:
        raise InputError(
            "the noise of the GNSS positions [m] is not given; add a line sigma = ... to the table "
            "[gnss]",
            field="gnss.sigma",
        )
    for name in ("huber", "student_t", "adaptive"):
        if name in tables.get("gate", {}):
            raise InputError("goes with a gyro and star cameras alone", field=f"gate.{name}")
    stars = settings.stars()
    single = not stars or list(stars) == ["star"]
    probability = settings.gate()
    return GnssStarNavigator(
        _filter(settings),
        dynamics(tables.get("orbit", {})),
        gnss=receiver(own),
        star=stars.get("star", StarCamera()) if single else stars,
        attitude=kinematic(tables.get("attitude", {})),
        gyro=settings.gyro() if gyro and "gyro" in tables else None,
        lfe=slow_error(tables["lfe"]) if "lfe" in tables else None,
        star_time_offset=_star_time_offset(tables),
        gate=GATE if probability is None else probability,
        max_rejected=_max_rejected(own),
    )


def receiver(values: Mapping[str, Any]) -> GnssReceiver:
    """Return the receiver; velocities whose noise is not given are not used."""
    from celestcore.gnss import GnssReceiver

    with _named("gnss"):
        return GnssReceiver(
            values["sigma"],
            values.get("sigma_velocity"),
            lever_arm=values.get("lever_arm", (0.0, 0.0, 0.0)),
            time_offset=values.get("time_offset", 0.0),
            bias=_fading(values, "gnss", "bias"),
        )


def dynamics(values: Mapping[str, Any]) -> OrbitDynamics:
    """Return forces, 20x20 gravity unless given, and their uncertainty."""
    from celestcore.gnss.navigator import ACCEL_PSD
    from celestcore.orbit import Drag, ForceModel, GravityField, OrbitDynamics, SolarPressure

    field = values.get("field", "JGM-3")
    if field not in FIELDS:
        raise InputError(f"must be one of {', '.join(FIELDS)}", field="orbit.field", value=field)
    gravity = values.get("gravity", 20)
    with _named("orbit"):
        force = ForceModel(
            gravity=tuple(gravity) if isinstance(gravity, list) else gravity,
            sun=values.get("sun", False),
            moon=values.get("moon", False),
            srp=_surface(values, "srp", ("cr", "area_to_mass"), SolarPressure),
            drag=_surface(values, "drag", ("cd", "area_to_mass"), Drag),
            field=GravityField.egm2008() if field == "EGM2008" else None,
        )
        step = {"max_step": values["max_step"]} if "max_step" in values else {}
        return OrbitDynamics(force, values.get("accel_psd", ACCEL_PSD), **step)


def kinematic(values: Mapping[str, Any]) -> KinematicAttitude:
    """Return how the body moves where there is no gyro."""
    from celestcore.gnss import KinematicAttitude

    return KinematicAttitude(**values)


def slow_error(values: Mapping[str, Any]) -> LowFrequencyError:
    """Return the star sensor's slow error."""
    from celestcore.gnss import LowFrequencyError

    with _named("lfe"):
        return LowFrequencyError(
            values.get("amplitudes", ()),
            period=values.get("period"),
            gauss_markov=_fading(values, "lfe", "fading"),
        )


def _filter(settings: Settings) -> Any:
    """Return the orbit filter."""
    values = settings.tables.get("filter", {})
    kind = values.get("kind", "ekf")
    if kind not in FILTERS:
        raise InputError(
            f"goes with gyro and star camera; with GNSS fixes it must be {' or '.join(FILTERS)}",
            field="filter.kind",
            value=kind,
        )
    for key in _ONLY_ATTITUDE:
        if key in values:
            raise InputError(
                "is an option of filters of gyro and star camera; an orbit is always integrated "
                "by rk4",
                field=f"filter.{key}",
                value=values[key],
            )
    return settings.filter()


def _fading(values: Mapping[str, Any], table: str, prefix: str) -> GaussMarkov | None:
    """Return an error that fades: both its sigma and its tau, or none. A sigma of 0 is none."""
    from celestcore.gnss import GaussMarkov

    keys = (f"{prefix}_sigma", f"{prefix}_tau")
    given = [key for key in keys if key in values]
    if not given or values.get(keys[0]) == 0.0:
        return None
    if len(given) == 1:
        raise InputError(f"needs both {keys[0]} and {keys[1]}", field=f"{table}.{given[0]}")
    for key in keys:
        number(values[key], f"{table}.{key}", above=0.0)
    return GaussMarkov(values[keys[0]], values[keys[1]])


def _surface(values: Mapping[str, Any], prefix: str, names: tuple[str, ...], kind: Any) -> Any:
    """Return drag or sunlight on a surface, if any of it is described."""
    options = {n: values[f"{prefix}_{n}"] for n in names if f"{prefix}_{n}" in values}
    if not options:
        return None
    if "area_to_mass" not in options:
        raise InputError(
            f"needs {prefix}_area_to_mass, too", field=f"orbit.{prefix}_{next(iter(options))}"
        )
    try:
        return kind(**options)
    except InputError as error:
        error.field = (error.field or prefix).replace(".", "_")
        raise


def _max_rejected(values: Mapping[str, Any]) -> int | None:
    given = values.get("max_rejected", 10)
    number(given, "gnss.max_rejected", at_least=0.0)
    if given != int(given):
        raise InputError("must be a whole number", field="gnss.max_rejected", value=given)
    return int(given) or None


def _star_time_offset(tables: Mapping[str, Mapping[str, Any]]) -> float:
    """Return the star sensors' time offset: the navigator has one for all of them."""
    found = {
        name: float(values.get("time_offset", 0.0))
        for name, values in tables.items()
        if table_kind(name) == "star"
    }
    if len(set(found.values())) > 1:
        name = next(iter(found))
        raise InputError(
            "must be the same for all star sensors; shift the times of the log",
            field=f"{name}.time_offset",
            value=found[name],
        )
    return next(iter(found.values()), 0.0)


@contextmanager
def _named(table: str) -> Iterator[None]:
    """Put the table's name before an error's field."""
    try:
        yield
    except InputError as error:
        if error.field is not None and error.field.partition(".")[0] != table:
            error.field = f"{table}.{error.field}"
        raise
