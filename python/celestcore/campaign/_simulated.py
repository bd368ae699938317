"""A simulated cell: from its tables to the job that the core runs."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from functools import lru_cache
from typing import Any

import numpy as np

from celestcore._campaign import LONGEST, STEPS, Job, Start, checked_skip, described
from celestcore._check import number
from celestcore._scores import COLUMNS, Scores, gather, score_columns
from celestcore.campaign._grid import canonical
from celestcore.campaign._schema import (
    CAMPAIGN,
    FILTERS,
    GYRO,
    PROFILES,
    STAR,
    TIMES,
    Tables,
    checked,
    table,
)
from celestcore.config import Settings
from celestcore.errors import InputError
from celestcore.navigator import StarGyroNavigator
from celestcore.simulate import (
    GyroErrors,
    Scenario,
    StarErrors,
    Truth,
    constant_rate,
    earth_pointing,
    slews,
)
from celestcore.simulate._scenario import whole

MAKERS: Mapping[str, Callable[..., Truth]] = {
    "earth_pointing": earth_pointing,
    "slews": slews,
    "constant_rate": constant_rate,
}
NEEDED = {"earth_pointing": (), "slews": (), "constant_rate": ("rate",)}
SPELLED = dict.fromkeys(("duration", "step", "slew_time", "hold_time"), "_s") | {
    "semi_major_axis": "_m"
}
"""What the keys of ``[scenario]`` end with that have one unit only."""
JOBS = 64
"""Cells that a process keeps at hand."""


def is_star(name: str) -> bool:
    return name == "star" or name.startswith("star_")


def settings_of(document: Mapping[str, Any]) -> dict[str, Any]:
    """Check the tables of a simulated cell, and return them in SI units.

    Raises
    ------
    InputError
        Names the table, the key and the value.
    """
    stars: Tables = {}
    for name, values in document.items():
        if is_star(name):
            stars[name] = checked(name, values, STAR)
        elif name not in ("campaign", "grid", "scenario", "gyro", "assumed", *FILTERS):
            known = "campaign, grid, scenario, gyro, star, star_NAME, assumed, filter, gate, start"
            raise InputError(f"unknown table; known are {known}", field=f"[{name}]")
    if "gyro" not in document or not stars:
        raise InputError("are needed with [scenario]: what the sensors do", field="[gyro], [star]")
    options = checked("campaign", document.get("campaign", {}), CAMPAIGN)
    return {
        "scenario": _profile(document["scenario"]),
        "gyro": checked("gyro", document["gyro"], GYRO),
        "stars": {name: _timed(name, document[name], stars[name]) for name in stars},
        "assumed": _assumed(document.get("assumed", {}), stars),
        "filter": Settings.from_dict({n: document[n] for n in FILTERS if n in document}).tables,
        "seed": str(whole(options.get("seed", 0), "campaign.seed", 64)),
        "skip": number(options.get("skip", 0.0), "campaign.skip_s", at_least=0.0),
        "start": options.get("start", "first_fix"),
        "smooth": options.get("smooth", False),
        "portable": options.get("portable", False),
    }


def _profile(values: Any) -> dict[str, Any]:
    given = table("scenario", values)
    profile = given.get("profile", "earth_pointing")
    if not isinstance(profile, str) or profile not in PROFILES:
        known = ", ".join(PROFILES)
        raise InputError(f"must be one of {known}", field="scenario.profile", value=profile)
    others = {key for name in PROFILES if name != profile for key in PROFILES[name]}
    for key in given:
        if key in others and key not in PROFILES[profile]:
            raise InputError(f"is no key of the profile {profile}", field=f"scenario.{key}")
    out = checked("scenario", given, TIMES | PROFILES[profile]) | {"profile": profile}
    for key in ("duration", *NEEDED[profile]):
        if key not in out:
            unit = {"duration": "_s", "rate": "_deg_per_s"}[key]
            raise InputError("is needed", field=f"scenario.{key}{unit}")
    return out


def _timed(name: str, given: Mapping[str, Any], values: dict[str, Any]) -> dict[str, Any]:
    """Check that a camera's offset has the unit that goes with its period."""
    wrong, right = "offset_s", "offset_samples"
    if "period" in values:
        wrong, right = right, wrong
    if wrong in given:
        where = f"{name}.{wrong}"
        raise InputError(f"does not go with how the fixes are timed: {right} does", field=where)
    return values


def _assumed(values: Any, stars: Tables) -> Tables:
    """Check what the filter believes of the sensors, where it differs from what they do."""
    given = table("assumed", values)
    for name in given:
        if name != "gyro" and name not in stars:
            known = ", ".join(("gyro", *stars))
            raise InputError(f"unknown table; flown are {known}", field=f"[assumed.{name}]")
    try:
        return Settings.from_dict(given).tables
    except InputError as error:
        if error.field is not None:
            error.field = f"assumed.{error.field}"
        raise


def _named(error: InputError, name: str) -> InputError:
    """Return an error of a camera under the name of its table."""
    if error.field is not None and error.field.startswith("star."):
        error.field = name + error.field.removeprefix("star")
    return error


@lru_cache(maxsize=8)
def _truth(text: str) -> Truth:
    values = json.loads(text)
    make = MAKERS[values.pop("profile")]
    if "step" in values:
        values["dt"] = values.pop("step")
    try:
        return make(**values)
    except InputError as error:
        name = "step" if error.field == "dt" else str(error.field)
        error.field = f"scenario.{name}{SPELLED.get(name, '')}"
        raise


def _scenario(settings: Mapping[str, Any]) -> Scenario:
    stars = {}
    for name, values in settings["stars"].items():
        try:
            stars[name] = StarErrors(**values)
        except InputError as error:
            raise _named(error, name) from None
    return Scenario(_truth(canonical(settings["scenario"])), GyroErrors(**settings["gyro"]), stars)


def _navigator(
    scenario: Scenario, settings: Mapping[str, Any]
) -> tuple[StarGyroNavigator, tuple[float, float] | None]:
    """Return a navigator that knows the sensors as they are flown, but for what is assumed."""
    gyro: dict[str, Any] = {
        "arw": float(np.max(scenario.gyro.arw)),
        "rrw": float(np.max(scenario.gyro.rrw)),
    }
    flown: Tables = {"gyro": gyro | _mounted(scenario.gyro.mounting)}
    for name, values in settings["stars"].items():
        known = {key: values[key] for key in ("sigma", "covariance") if key in values}
        flown[name] = known | _mounted(values.get("mounting"))
    both = Settings.from_dict(flown).merged(settings["assumed"]).merged(settings["filter"])
    return both.navigator(), both.sigma0()


def _mounted(mounting: Any) -> dict[str, Any]:
    return {} if mounting is None else {"mounting": list(mounting)}


@lru_cache(maxsize=JOBS)
def job_of(text: str) -> Job:
    """Return what the core runs, of settings as `canonical` writes them.

    Raises
    ------
    InputError
        If a value is out of range.
    """
    settings = json.loads(text)
    scenario = _scenario(settings)
    nav, sigma0 = _navigator(scenario, settings)
    name, smooth = nav.filter.kind, settings["smooth"]
    if settings["start"] == "drawn" and sigma0 is None:
        raise InputError('is needed with start = "drawn"', field="[start]")
    start = Start(settings["start"], sigma0, {name: nav})
    try:
        skip = checked_skip(settings["skip"], scenario.truth.t, smooth)
    except InputError as error:
        error.field = "campaign.skip_s"
        raise
    return Job(
        flight=scenario._described(),
        estimators=[described(scenario, nav, start.of(name), smooth)],
        seed=int(settings["seed"]),
        skip=skip,
        threads=1,
        portable=settings["portable"],
    )


def batch(text: str, most: int) -> int:
    """Return how many trials go into one task: some tenths of a second, in whole groups."""
    job = job_of(text)
    steps = len(job.flight["t"]) + job.readings()
    size = max(1, min(STEPS // steps, most))
    return size if job.group * steps > LONGEST else -(-size // job.group) * job.group


def rows(
    text: str, first: int, trials: int, progress: Callable[[int, int], object]
) -> dict[str, list[Any]]:
    """Run consecutive trials, and return a column for each score."""
    parts = job_of(text)(first, trials, progress)
    scores = gather(Scores, COLUMNS, [parts[0]], first)
    columns = {name: np.asarray(v).tolist() for name, v in score_columns(scores).items()}
    columns["failure"] = [scores.failures.get(int(trial)) for trial in scores.trial]
    return columns


@lru_cache(maxsize=JOBS)
def seed_of(text: str) -> int:
    """Return the seed of a cell."""
    return int(json.loads(text)["seed"])
