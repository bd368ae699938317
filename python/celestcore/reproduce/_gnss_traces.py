"""Single runs, for the figures, and what a run with a gyro says of the slow error."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

import celestcore as cc
from celestcore import quaternion
from celestcore.gnss._scores import attitude_error
from celestcore.reproduce import _gnss_model as model
from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce._gnss_reference import euler_error, star_error
from celestcore.reproduce._gnss_series import Array


class Flight(NamedTuple):
    """One run at one level of GPS noise, epoch by epoch."""

    t: Array
    track: Array
    """True longitude, latitude [rad] and height [m] (n, 3)."""
    filtered: Array
    fixes: Array
    position: Array
    """Errors along the track, across it to the right, and down (n, 3) [m]; their 1-sigma next."""
    position_sigma: Array
    raw_position: Array
    attitude: Array
    """Errors in roll, pitch and yaw (n, 3) [rad]; their 1-sigma next."""
    attitude_sigma: Array
    raw_attitude: Array


class Turn(NamedTuple):
    """One slew through 90 degrees of pitch: errors' lengths [rad]."""

    t: Array
    pitch: Array
    """True pitch, going on past 90 degrees [rad]."""
    euler: Array
    navigator: Array
    star: Array


class SlowError(NamedTuple):
    """What one run with a gyro says of the star sensor's slow error in pitch [rad]."""

    t: Array
    true: Array
    found: Array
    sigma: Array


class Observed(NamedTuple):
    """Eigenvalues of the first harmonic's coefficients, sigma over prior, by run (runs, 6)."""

    first: Array
    every: Array
    """Of all coefficients (runs, 12)."""
    unobservable: list[int]
    """How many combinations each run's report calls unobservable."""
    text: str
    """The first run's report."""


@dataclass(frozen=True)
class Traces:
    """Single runs: flights by GPS noise, a slew, and the slow error."""

    flights: dict[float, Flight]
    turn: Turn
    slow: SlowError


def flight(gps: float, seed: int) -> Flight:
    """Return the first run of a level, with the slow error and its states."""
    cell = model.Cell("lfe", gps)
    made = model.scenario(cell).trial(seed, 0)
    sol = model.navigators(cell)["states"].run(made.log, t_output=made.t, covariance=True)
    assert sol.orbit_covariance is not None
    assert sol.q is not None
    assert sol.sigma_q is not None
    table = made.log.gnss
    assert table is not None
    to_orbit = np.swapaxes(quaternion.to_matrix(cc.frames.orbital(made.r_i, made.v_i)), 1, 2)
    earth = cc.frames.itrs_to_gcrs(made.log.epoch, made.t)
    covariance = to_orbit @ sol.orbit_covariance[:, :3, :3] @ np.swapaxes(to_orbit, 1, 2)
    turned = np.einsum("nji,nj->ni", earth, sol.r)

    def along(e: Array) -> Array:
        return np.asarray(np.einsum("nij,nj->ni", to_orbit, e))

    return Flight(
        t=made.t,
        track=ground(made.r_e),
        filtered=ground(turned),
        fixes=ground(table.r),
        position=along(sol.r - made.r_i),
        position_sigma=np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)),
        raw_position=along(np.einsum("nij,nj->ni", earth, table.r - made.r_e)),
        attitude=-attitude_error(sol.q, made.q_ib),
        attitude_sigma=sol.sigma_q,
        raw_attitude=-star_error(made),
    )


def ground(r_e: Array) -> Array:
    """Return longitude, latitude [rad] and height [m] (n, 3)."""
    found = cc.frames.geodetic(r_e)
    return np.stack([found.longitude, found.latitude, found.height], axis=1)


def turn(seed: int) -> Turn:
    """Return the first run of the slew."""
    cell = model.Cell("slew")
    made = model.scenario(cell).trial(seed, 0)
    sol = model.navigators(cell)["20x20"].run(made.log, t_output=made.t)
    assert sol.q is not None
    return Turn(
        made.t,
        model.SLEW.pitch(made.t)[0],
        np.linalg.norm(euler_error(made), axis=1),
        np.linalg.norm(attitude_error(sol.q, made.q_ib), axis=1),
        np.linalg.norm(star_error(made), axis=1),
    )


def observability(seed: int, runs: int, told: Any) -> tuple[Observed, SlowError]:
    """Run the first few trials with a gyro, and ask what they saw of the slow error."""
    cell = model.Cell("gyro")
    scenario, nav = model.scenario(cell), model.navigators(cell)["states"]
    reports, slow = [], None
    for k in range(runs):
        made = scenario.trial(seed, k)
        report = nav.run(made.log, t_output=[0.0, made.t[-1]]).lfe
        assert report is not None
        reports.append(report)
        slow = _pitch(made, report) if slow is None else slow
        told(1)
    assert slow is not None
    observed = Observed(
        np.array([r.part("cos 1", "sin 1") for r in reports]),
        np.array([r.eigenvalues for r in reports]),
        [r.unobservable for r in reports],
        str(reports[0]),
    )
    return observed, slow


def _pitch(made: Any, report: Any) -> SlowError:
    """Return the slow error about y over time, and what the coefficients make of it."""
    period = 2.0 * np.pi / model.scenario(model.Cell("gyro")).mean_motion
    weights = cc.LowFrequencyError(model.LFE).weights(made.t, period)
    each = report.prior.reshape(-1)
    scaled = (report.eigenvectors * report.eigenvalues**2) @ report.eigenvectors.T
    covariance = (scaled * np.outer(each, each))[1::3, 1::3]
    sigma = np.sqrt(np.einsum("ni,ij,nj->n", weights, covariance, weights))
    return SlowError(made.t, made.star_bias[:, 1], weights @ report.value[:, 1], sigma)


def traces(seed: int, slow: SlowError) -> Traces:
    """Return the runs that the figures show."""
    return Traces({gps: flight(gps, seed) for gps in paper.GPS}, turn(seed), slow)
