"""One trial of a scenario: attitude, errors, and the log that comes of them."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from celestcore import quaternion, simulate
from celestcore._check import BoolArray, FloatArray
from celestcore.gnss import _noise
from celestcore.gnss._flight import Place, antenna
from celestcore.gnss.scenario import GnssStarScenario, GnssStarTrial
from celestcore.log import SensorLog


class Attitude(NamedTuple):
    """The attitude at some times (n,)."""

    q_ib: FloatArray
    q_ob: FloatArray
    omega_b: FloatArray
    rate_o: FloatArray


class Fixes(NamedTuple):
    """What a sensor reports, its slow error, and which fixes are outliers."""

    parts: tuple[FloatArray, ...]
    bias: FloatArray
    outlier: BoolArray


def simulated(scenario: GnssStarScenario, seed: int, trial: int) -> GnssStarTrial:
    """Return a trial."""
    places, rng = scenario._flight, _noise.streams(seed, trial)
    phases = 2.0 * np.pi * rng["attitude"].random(3)
    coefficients = _noise.random_harmonics(rng["lfe"], scenario.lfe)
    truth, at_star = places["truth"], places["star"]
    attitude = _attitude(scenario, truth, phases)
    star = _star(scenario, at_star, _attitude(scenario, at_star, phases), coefficients, rng)
    at_gnss = _attitude(scenario, places["gnss"], phases)
    gnss = _gnss(scenario, places["gnss"], at_gnss, rng)
    tables: dict[str, Any] = {"star": star.parts, "gnss": gnss.parts}
    if scenario.baselines is not None:
        tables["baselines"] = _baselines(scenario, places["gnss"], at_gnss, rng)
    gyro_bias = None
    if scenario.gyro is not None:
        q = _attitude(scenario, places["gyro"], phases).q_ib
        tables["gyro"], gyro_bias = _gyro(scenario, places["gyro"], q, (seed, trial))
    assert truth.r_e is not None
    assert truth.v_e is not None
    return GnssStarTrial(
        log=SensorLog(epoch=scenario.epoch, **tables),
        t=truth.t,
        r_i=truth.r_i,
        v_i=truth.v_i,
        r_e=truth.r_e,
        v_e=truth.v_e,
        **attitude._asdict(),
        lfe=coefficients,
        star_bias=star.bias,
        gnss_bias=gnss.bias,
        gnss_outlier=gnss.outlier,
        star_outlier=star.outlier,
        gyro_bias=gyro_bias,
        seed=seed,
        trial=trial,
    )


def _attitude(scenario: GnssStarScenario, place: Place, phases: FloatArray) -> Attitude:
    q_ob, rate_o = scenario.attitude.attitude(place.t, phases)
    q_ib = quaternion.continuous(quaternion.multiply(place.q_io, q_ob))
    omega_b = rate_o + quaternion.rotate(quaternion.conjugate(q_ob), place.rate_io)
    return Attitude(q_ib, q_ob, omega_b, rate_o)


def _star(
    scenario: GnssStarScenario,
    place: Place,
    attitude: Attitude,
    coefficients: FloatArray,
    rng: dict[str, np.random.Generator],
) -> Fixes:
    n, t = len(place.t), place.t
    bias = _noise.harmonics(coefficients, scenario.mean_motion * t)
    bias = bias + _noise.markov(rng["star_markov"], t, scenario.lfe_markov)
    outlier, wrong = _noise.outliers(rng["star_outliers"], n, scenario.star_outliers)
    sigma = np.array(scenario.star_sigma)
    error = bias + sigma * (rng["star"].standard_normal((n, 3)) + wrong[:, 0])
    q = attitude.q_ib
    if scenario.star_mounting is not None:
        q = quaternion.multiply(q, scenario.star_mounting)
    q = quaternion.continuous(quaternion.multiply(q, quaternion.exp(error)))
    return Fixes((t - scenario.star_offset, q), bias, outlier)


def _gnss(
    scenario: GnssStarScenario,
    place: Place,
    attitude: Attitude,
    rng: dict[str, np.random.Generator],
) -> Fixes:
    n = len(place.t)
    arm = np.broadcast_to(np.array(scenario.lever_arm), (n, 3))
    moving = np.cross(attitude.omega_b, arm)
    r, v = antenna(
        place, quaternion.rotate(attitude.q_ib, arm), quaternion.rotate(attitude.q_ib, moving)
    )
    bias = _noise.markov(rng["gnss_markov"], place.t, scenario.gnss_markov)
    outlier, wrong = _noise.outliers(rng["gnss_outliers"], n, scenario.gnss_outliers)
    sigma, sigma_v = scenario.gnss_sigma, scenario.velocity_sigma
    r = r + bias + sigma * (rng["gnss_position"].standard_normal((n, 3)) + wrong[:, 0])
    v = v + sigma_v * (rng["gnss_velocity"].standard_normal((n, 3)) + wrong[:, 1])
    t = place.t - scenario.gnss_offset
    return Fixes((t, r, v) if scenario.gnss_velocity else (t, r), bias, outlier)


def _baselines(
    scenario: GnssStarScenario,
    place: Place,
    attitude: Attitude,
    rng: dict[str, np.random.Generator],
) -> tuple[FloatArray, FloatArray]:
    assert place.earth is not None
    b = np.array(scenario.baselines)
    to_earth = place.earth @ quaternion.to_matrix(attitude.q_ib)
    true = np.einsum("nij,kj->nki", to_earth, b)
    each = rng["baselines"].standard_normal((len(place.t), len(b) + 1, 3))
    noise = scenario.baseline_sigma / np.sqrt(2.0) * (each[:, 1:] - each[:, :1])
    return place.t - scenario.gnss_offset, true + noise


def _gyro(
    scenario: GnssStarScenario, place: Place, q: FloatArray, drawn: tuple[int, int]
) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Return the table and the bias; the noise is that of `celestcore.simulate`."""
    assert scenario.gyro is not None
    truth = simulate.attitude(place.t, q)
    unused = simulate.StarErrors(1e-3, every=len(place.t))
    made = simulate.Scenario(truth, scenario.gyro, unused).simulate(*drawn)
    assert made.log.gyro is not None
    return (place.t - scenario.gyro_offset, made.log.gyro.rate), made.bias
