"""What a navigator's runs over logs have in common: a log for the core, and its answer."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore._arguments import (
    Sigma0,
    checked,
    count,
    covariance_of,
    one_quaternion,
    sigma_of,
    three,
)
from celestcore._check import number, warn
from celestcore._tables import table_kind
from celestcore.errors import InputError
from celestcore.log import SensorLog
from celestcore.solution import Solution

if TYPE_CHECKING:
    from celestcore.navigator import StarGyroNavigator
    from celestcore.quaternion import QuaternionLike

FloatArray: TypeAlias = NDArray[np.float64]
BIAS_SIGMA = 1e-3
"""1-sigma gyro bias [rad/s] that a start assumes if none is given (200 deg/h)."""
REJECTED = 0.5
"""Share of measurements outside the gate beyond which a run warns."""
START: dict[str, Any] = {
    "t0": None,
    "q0": None,
    "bias0": (0.0, 0.0, 0.0),
    "sigma0": None,
    "covariance0": None,
    "noise_scale0": None,
}
OUTPUT: dict[str, Any] = {
    "every": 1,
    "period": None,
    "covariance": False,
    "innovations": "full",
    "progress": None,
    "portable": False,
}
"""Options of a run and what they are if they are not given."""
KEPT = ("full", "nis", "none")
"""What may be kept of the measurements."""


def checked_options(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a run, those that are not given as they are by default.

    Raises
    ------
    InputError
        Names the option and the value.
    """
    known = {**START, **OUTPUT}
    for name in given:
        if name not in known:
            raise InputError(f"is not an option; known are {', '.join(known)}", field=name)
    o = {**known, **given}
    if o["progress"] is not None and not callable(o["progress"]):
        raise InputError("must be callable as progress(done, total)", field="progress")
    if o["period"] is not None:
        if o["every"] != 1:
            raise InputError(
                "goes without every: give one of them", field="period", value=o["period"]
            )
        o["period"] = number(o["period"], "period", above=0.0)
    if o["innovations"] not in KEPT:
        known_words = ", ".join(KEPT)
        raise InputError(
            f"must be one of {known_words}", field="innovations", value=o["innovations"]
        )
    o["every"] = count(o["every"], "every")
    return o


def prepare(
    nav: StarGyroNavigator, log: SensorLog, given: Mapping[str, Any]
) -> tuple[dict[str, Any], list[str]]:
    """Return a log with its start and its options for the core, and the sensors' names.

    Raises
    ------
    InputError
        Names the option, or the table, and the value.
    """
    gyro = checked(log, "log", SensorLog).gyro
    if gyro is None:
        raise InputError("the log has no gyro table; it has " + ", ".join(log.tables))
    o = checked_options(given)
    names, sensors = _sensors(nav, log)
    turn = nav.gyro._turn()
    sigma0 = o["sigma0"]
    call = {
        "gyro_t": gyro.t,
        "gyro_rate": gyro.rate,
        "gyro_turn": None if turn is None else turn.reshape(-1).tolist(),
        "sensors": sensors,
        "setup": nav._setup(nav._max_gap(gyro.t)),
        "start": _start(gyro.t, o["t0"], o["q0"], sigma0, o["covariance0"]),
        "bias0": three(o["bias0"], "bias0"),
        "bias_sigma": [BIAS_SIGMA] * 3 if sigma0 is None else sigma_of(sigma0)[3:].tolist(),
        "every": o["every"],
        "period": o["period"],
        "covariance": bool(o["covariance"]),
        "innovations": o["innovations"],
        "portable": bool(o["portable"]),
        "noise_scale": _scales(nav, names, o["noise_scale0"]),
        "progress": o["progress"],
    }
    return call, names


def _scales(
    nav: StarGyroNavigator, names: list[str], given: Mapping[str, float] | None
) -> list[float]:
    """Return what each sensor's noise is multiplied by at the start, nothing if it is not found."""
    if given is not None and nav.adaptive is None:
        raise InputError("goes with StarGyroNavigator(adaptive=...)", field="noise_scale0")
    if given is not None and not isinstance(given, Mapping):
        raise InputError(
            "must be a mapping from sensor names to factors", field="noise_scale0", value=given
        )
    known = {} if given is None else dict(given)
    for name, value in known.items():
        # a sensor that is silent in this log is none of it, but one that could not be is a mistake
        if table_kind(name) not in ("star", "vector"):
            raise InputError(
                f"is no sensor with noise; this log has {', '.join(names)}",
                field=f"noise_scale0[{name!r}]",
            )
        known[name] = number(value, f"noise_scale0[{name!r}]", above=0.0)
    return [] if nav.adaptive is None else [known.get(name, 1.0) for name in names]


def _sensors(nav: StarGyroNavigator, log: SensorLog) -> tuple[list[str], list[tuple[Any, ...]]]:
    """Return the sensors' names, and columns and mountings for the core: nothing is copied."""
    names: list[str] = []
    sensors: list[tuple[Any, ...]] = []
    for name, star in log.stars.items():
        camera = nav._camera(name)
        names.append(name)
        noise = camera._noise_for_core(star.noise)
        sensors.append(("star", star.t, star.q, noise, camera.mounting))
    for name, table in log.vectors.items():
        sensor = nav._direction(name)
        sigma = table.sigma
        if sigma is None:
            if sensor is None:
                raise InputError(
                    "has no noise; give StarGyroNavigator(vector=VectorSensor(sigma=...))",
                    field=f"vector_{name}.sigma",
                )
            sigma = np.array([sensor.sigma])
        turn = None if sensor is None else sensor._turn()
        names.append(f"vector_{name}")
        sensors.append(("vector", table.t, table.body, table.inertial, sigma, turn))
    return names, sensors


def _start(
    t: FloatArray,
    t0: float | None,
    q0: QuaternionLike | None,
    sigma0: Sigma0 | None,
    covariance0: ArrayLike | None,
) -> tuple[float, tuple[float, ...], FloatArray] | None:
    if q0 is None:
        if t0 is not None:
            raise InputError("goes with q0, the attitude then", field="t0", value=t0)
        if covariance0 is not None:
            raise InputError("goes with q0, the attitude then", field="covariance0")
        return None
    if len(t) == 0:
        raise InputError("has no samples", field="gyro")
    begin = float(t[0]) if t0 is None else number(t0, "t0")
    if not t[0] <= begin <= t[-1]:
        raise InputError(
            f"must lie within the gyro's time span, {t[0]:.10g} to {t[-1]:.10g} s",
            field="t0",
            value=begin,
        )
    return begin, one_quaternion(q0, "q0"), covariance_of(sigma0, covariance0)


def finish(
    nav: StarGyroNavigator,
    log: SensorLog,
    names: list[str],
    call: Mapping[str, Any],
    out: dict[str, Any],
    label: str = "",
    **more: Any,
) -> Solution:
    """Return the core's answer to a call as a solution; a warning begins with the label."""
    gyro = log.gyro
    assert gyro is not None
    # what a filter does not use (LiteralUKF and directions) is neither accepted nor rejected
    accepted, outside, unused = out["tally"]
    measurements = accepted + outside + unused
    if outside > max(10, REJECTED * measurements):
        warn(
            f"{label}{outside} of {measurements} measurements were outside the gate: "
            "the start, the noise or the frames are probably wrong"
        )
    innovation, innovation_sigma = out["innovation"], out["innovation_sigma"]
    if call["innovations"] == "nis":  # not known, and without memory
        innovation = innovation_sigma = np.broadcast_to(np.nan, (measurements, 3))
    start_fix = out["start_fix"] is not None
    p_final = out["final_covariance"]
    scales = dict(zip(names, out["noise_scale"], strict=True)) if nav.adaptive is not None else None
    fixes = sum(len(table) for table in (*log.stars.values(), *log.vectors.values()))
    return Solution(
        **{name: out[name] for name in ("t", "q", "rate", "bias", "sigma", "measurement_t")},
        **{name: out[name] for name in ("sensor", "nis", "dof", "accepted", "gaps")},
        innovation=innovation,
        innovation_sigma=innovation_sigma,
        innovations=call["innovations"],
        covariance=out["covariance"] if len(out["covariance"]) else None,
        counts={
            "samples": len(gyro),
            "fixes": fixes,
            "accepted": accepted,
            "rejected": outside + unused,
            "start": int(start_fix),
            "missing": log.missing,
            "outside": int(out["outside"]),
            "gaps": len(out["gaps"]),
        },
        sensor_names=names,
        epoch=log.epoch,
        title=log.title,
        filter=nav.filter.kind,
        elapsed_s=out["elapsed_s"],
        final={
            "t": out["final_t"],
            "q": out["final_q"],
            "bias": out["final_bias"],
            "sigma": np.sqrt(np.diag(p_final)),
            "covariance": p_final,
            **({} if scales is None else {"noise_scale": scales}),
        },
        frames=log.frames,
        log_likelihood=float(out["log_likelihood"]),
        **more,
    )
