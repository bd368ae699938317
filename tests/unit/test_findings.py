"""What to look at next: each rule fires on its fault and is silent without it."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import _findings
from celestcore._fixes import Fixes, configured_noise, of_attitude
from celestcore._health import (
    FEW,
    FINE,
    MANY_REJECTED,
    NO_FIXES,
    TOO_HIGH,
    TOO_LOW,
    bursts,
    noise,
    windows,
)
from celestcore.report import page
from celestcore.solution import Solution
from celestcore.summary import summary
from celestcore.units import ARCSEC

MakeSolution = Callable[..., Solution]
N = 4000


def clean(make: MakeSolution, change: Callable[[dict[str, Any]], None] | None = None) -> Solution:
    """Return a solution without faults: white innovations, no gaps; then change its columns."""
    base = make(2 * N)
    sigma = np.tile(ARCSEC * np.array([6.0, 7.0, 18.0]), (N, 1))
    made: dict[str, Any] = {
        "innovation": sigma * np.random.default_rng(4).standard_normal((N, 3)),
        "innovation_sigma": sigma,
        "accepted": np.ones(N, dtype=bool),
        "gaps": np.zeros((0, 2)),
        "sigma": np.tile(base.sigma[-1], (2 * N, 1)),
        "bias": np.tile(base.bias[-1], (2 * N, 1)),
        "measurement_t": base.measurement_t,
    }
    if change is not None:
        change(made)
    nis = np.sum((made["innovation"] / made["innovation_sigma"]) ** 2, axis=1)
    used = int(made["accepted"].sum())
    counts = {"samples": 2 * N, "fixes": N, "accepted": used, "rejected": N - used}
    return make(2 * N, nis=nis, **{"counts": counts, **made})


def rules(solution: Solution) -> set[str]:
    found = summary(solution)["findings"]
    json.dumps(found, allow_nan=False)
    assert all(f["words"] and f["title"] and f["level"] in ("act", "look", "fine") for f in found)
    return {f["rule"] for f in found}


def test_a_good_run_gives_nothing_to_look_at(make_solution: MakeSolution) -> None:
    assert rules(clean(make_solution)) == {"nothing"}


def _scaled(factor: Any) -> Callable[[dict[str, Any]], None]:
    def change(made: dict[str, Any]) -> None:
        made["innovation"] = made["innovation"] * factor

    return change


def _offset(made: dict[str, Any]) -> None:
    made["innovation"] = made["innovation"] + ARCSEC * np.array([0.0, 4.0, 0.0])


def _slow(made: dict[str, Any]) -> None:
    z = made["innovation"].copy()
    for k in range(1, N):
        z[k] = 0.6 * z[k - 1] + 0.8 * z[k]
    made["innovation"] = z


def _burst(made: dict[str, Any]) -> None:
    made["accepted"][1000:1007] = False


def _gap(made: dict[str, Any]) -> None:
    made["gaps"] = np.array([[100.0, 130.0]])


def _silent(made: dict[str, Any]) -> None:
    made["measurement_t"] = made["measurement_t"] + 50.0 * (np.arange(N) > N // 2)


def _settling(made: dict[str, Any]) -> None:
    made["sigma"] = made["sigma"] * np.linspace(3.0, 1.0, 2 * N)[:, None]


def _wandering(made: dict[str, Any]) -> None:
    made["bias"] = made["bias"] + 9.0 * made["sigma"][:, 3:] * np.linspace(0, 1, 2 * N)[:, None]


def _none_used(made: dict[str, Any]) -> None:
    made["accepted"][:] = False


@pytest.mark.parametrize(
    ("change", "expected"),
    [
        (_scaled(1.3), {"NIS too large"}),
        (_scaled(0.7), {"NIS too small"}),
        (_scaled(np.array([0.8, 0.8, 1.3])), {"axes differ"}),
        (_offset, {"innovations off centre"}),
        (_slow, {"not white"}),
        (_burst, {"rejected bursts"}),
        (_gap, {"gaps"}),
        (_silent, {"long without fixes"}),
        (_settling, {"bias not settled"}),
        (_wandering, {"bias wanders"}),
        (_none_used, {"many rejected", "none used", "not judged"}),
    ],
)
def test_each_fault_is_named(
    make_solution: MakeSolution,
    change: Callable[[dict[str, Any]], None],
    expected: set[str],
) -> None:
    assert rules(clean(make_solution, change)) == expected


def test_the_burst_tells_when(make_solution: MakeSolution) -> None:
    found = summary(clean(make_solution, _burst))["findings"][0]
    assert found["at"] == [2001.0, 2013.0]
    assert "has 7, from t = 2001 to 2013 s" in found["words"]


def test_missing_and_outside_are_named(make_solution: MakeSolution) -> None:
    sol = clean(make_solution)
    sol = dataclasses.replace(sol, counts={**sol.counts, "missing": 500, "outside": 90})
    assert rules(sol) == {"missing values", "outside the run"}


def one(nis: Any, accepted: Any, t: Any) -> Fixes:
    used = np.asarray(accepted, dtype=bool)
    return Fixes(
        "star", "arcsec", ("x", "y", "z"), np.asarray(t), np.asarray(nis), 3, used, None, None
    )


def test_windows_tell_the_states_apart() -> None:
    rng = np.random.default_rng(2)
    t = np.arange(2400.0)
    nis = rng.chisquare(3, 2400)
    nis[240:480] *= 4.0
    nis[480:720] *= 0.1
    accepted = np.ones(2400, dtype=bool)
    accepted[720:960:3] = False
    there = (t < 960) | (t >= 1200)
    accepted[1200:1440] = False
    seen = windows(one(nis[there], accepted[there], t[there]), 0.0, 2400.0)
    middle = 0.5 * (seen.edge[1:] + seen.edge[:-1])
    by_part = [
        np.unique(seen.state[(middle > 240 * k + 25) & (middle < 240 * k + 215)]) for k in range(7)
    ]
    assert by_part == [
        [FINE],
        [TOO_HIGH],
        [TOO_LOW],
        [MANY_REJECTED],
        [NO_FIXES],
        [MANY_REJECTED],
        [FINE],
    ]
    joined = seen.segments()
    assert joined[0][0] == 0.0
    assert joined[-1][1] == 2400.0
    assert sum(n for *_, n, _ in joined) == int(there.sum())


def test_a_window_with_nothing_to_judge_by() -> None:
    seen = windows(one([1.0, 1.0], [False, False], [1.0, 2.0]), 0.0, 3.0)
    assert seen.state.tolist() == [FEW]


def test_bursts_are_sorted_by_length() -> None:
    accepted = np.ones(40, dtype=bool)
    accepted[:6] = False
    accepted[20:29] = False
    accepted[35:38] = False
    found = bursts(one(np.ones(40), accepted, np.arange(40.0)))
    assert found == [
        {"begin": 20.0, "end": 28.0, "fixes": 9},
        {"begin": 0.0, "end": 5.0, "fixes": 6},
    ]


def test_the_innovations_tell_the_cameras_noise() -> None:
    """A camera of 3, 3 and 20 arcsec that is said to have 8: the report finds what it has."""
    rng = np.random.default_rng(8)
    t = np.arange(4000.0)
    true = np.array([3.0, 3.0, 20.0])
    fixes = cc.quaternion.exp(true * ARCSEC * rng.standard_normal((4000, 3)))
    log = cc.SensorLog(gyro=(t, 1e-7 * rng.standard_normal((4000, 3))), star=(t, fixes))
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-7, 1e-11), cc.StarCamera(8.0 * ARCSEC))
    sol = nav.run(log)
    (star,) = of_attitude(sol, configured_noise(nav, log))
    found = noise(star)
    assert found is not None
    np.testing.assert_allclose(found["configured"], 8.0)
    np.testing.assert_allclose(found["seen"], true, rtol=0.1)
    (sensor,) = summary(sol, log, navigator=nav)["sensors"]
    assert sensor["noise"] == found


def test_configured_noise_is_turned_into_the_body_and_taken_from_the_fixes() -> None:
    t, q = np.arange(3.0), np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
    turn = [0.5**0.5, 0.0, 0.5**0.5, 0.0]  # about y: the camera's z is the body's x
    camera = cc.StarCamera([1e-5, 2e-5, 9e-5], mounting=turn)
    log = cc.SensorLog(gyro=(t, np.zeros((3, 3))), star=(t, q))
    nav = cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6), camera)
    np.testing.assert_allclose(configured_noise(nav, log)["star"], [9e-5, 2e-5, 1e-5])
    own = cc.SensorLog(gyro=(t, np.zeros((3, 3))), star=(t, q, np.full((3, 3), 3e-5)))
    np.testing.assert_allclose(configured_noise(nav, own)["star"], 3e-5)


def adaptive_run(told: float, true: float) -> tuple[cc.StarGyroNavigator, cc.SensorLog]:
    """Return a navigator that finds a camera's noise itself, and a log of that camera [arcsec]."""
    rng = np.random.default_rng(9)
    t = np.arange(4000.0)
    fixes = cc.quaternion.exp(true * ARCSEC * rng.standard_normal((4000, 3)))
    log = cc.SensorLog(gyro=(t, 1e-6 * rng.standard_normal((4000, 3))), star=(t, fixes))
    camera = cc.StarCamera(told * ARCSEC)
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(1e-6, 1e-10), camera, adaptive=100.0), log


@pytest.mark.parametrize("told", [10.3, 41.3, 165.0])
def test_noise_as_seen_of_an_adaptive_run_is_the_true_one(told: float) -> None:
    """The prediction holds the noise found so far, not the one that was told."""
    nav, log = adaptive_run(told, 41.3)
    sol = nav.run(log)
    result = summary(sol, log, navigator=nav)
    (sensor,) = result["sensors"]
    np.testing.assert_allclose(sensor["noise"]["configured"], told)
    np.testing.assert_allclose(sensor["noise"]["seen"], 41.3, rtol=0.1)
    assert sensor["noise_scale"] == sol.final["noise_scale"]["star"]
    times = np.sqrt(sensor["noise_scale"])
    assert times == pytest.approx(41.3 / told, rel=0.15)
    words = f"star: noise found while running: {times:.3g} times as told"
    assert words in page(sol, result)
    assert words in page(sol, summary(sol, log))  # without the navigator, too


def test_a_run_that_does_not_adapt_says_nothing_of_noise_found(solution: Solution) -> None:
    result = summary(solution)
    assert all(sensor["noise_scale"] is None for sensor in result["sensors"])
    assert "noise found" not in page(solution, result)


def test_a_part_of_an_adaptive_run_is_judged_by_the_noise_found_too() -> None:
    nav, log = adaptive_run(10.3, 41.3)
    sol = nav.run(log)
    part = sol[2000.0:3000.0]
    (sensor,) = summary(part, log, navigator=nav)["sensors"]
    assert sensor["noise_scale"] == sol.final["noise_scale"]["star"]
    np.testing.assert_allclose(sensor["noise"]["seen"], 41.3, rtol=0.15)


@pytest.mark.parametrize(
    ("rejected", "gate", "rules"),
    [
        (0, 0.9999, []),
        (9, 0.9999, []),
        (12, 0.99, []),  # of good ones ten
        (50, 0.9999, ["some rejected"]),
        (50, None, []),  # nothing is refused without a gate: what is not used is another matter
        (200, 0.9999, ["many rejected"]),
    ],
)
def test_rejections_of_a_gate(rejected: int, gate: float | None, rules: list[str]) -> None:
    counts = {"accepted": 1000 - rejected, "rejected": rejected}
    assert [found["rule"] for found in _findings.of_rejections(counts, gate)] == rules
