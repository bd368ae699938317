"""The orbit that the majority of the first fixes agrees on."""

from __future__ import annotations

import functools
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import frames, orbit
from celestcore.gnss.scenario import GnssStarScenario
from celestcore.gnss.start import OrbitStart, orbit_start

Array = np.ndarray[Any, Any]
EPOCH = "2019-01-21T04:00:00"
TRUTH = orbit.ForceModel(gravity=21, sun=True, moon=True)


@functools.cache
def tables() -> dict[str, Any]:
    return frames.environment(EPOCH, (0.0, 10000.0))


def random_orbit(rng: np.random.Generator) -> tuple[Array, Array]:
    a = rng.choice([6800e3, 6884e3, 7200e3, 10000e3, 26560e3, 42164e3])
    e = rng.uniform(0.0, min(0.3, 1.0 - 6650e3 / a))
    angles = rng.uniform(0.0, [np.pi, *[2.0 * np.pi] * 3])
    return cc.elements.to_state(cc.elements.Elements(a, e, *angles))


def flown(t: Array, seed: int) -> orbit.Trajectory:
    r0, v0 = random_orbit(np.random.default_rng((seed, 1)))
    return orbit.propagate(TRUTH, None, r0, v0, t, environment=tables())


def spacing(seed: int) -> Array:
    rng = np.random.default_rng((seed, 2))
    steps = rng.choice([1.0, 5.0, 10.0, 30.0, 60.0], 7)
    return np.r_[0.0, np.cumsum(steps if seed % 2 else np.full(7, steps[0]))]


def measured(made: orbit.Trajectory, sigma: float, seed: int) -> tuple[Array, Array]:
    rng = np.random.default_rng((seed, 3))
    r = made.r + sigma * rng.standard_normal(made.r.shape)
    return r, made.v + 0.01 * sigma * rng.standard_normal(made.r.shape)


def slack(t: Array) -> float:
    """What J2 leaves out, at the first fix of a fit over all."""
    return 0.5 * 1e-4 * float(t[-1] - t[0]) ** 2


def check(start: OrbitStart, made: orbit.Trajectory, sigma: float, bad: Any) -> None:
    expected = np.ones(len(start.good), dtype=bool)
    expected[bad] = False
    assert start.good.tolist() == expected.tolist()
    assert start.t == made.t[0]
    assert np.linalg.norm(start.r - made.r[0]) < 10.0 * sigma + slack(made.t)


@pytest.mark.parametrize("with_velocity", [False, True])
@pytest.mark.parametrize("sigma", [1.0, 10.0])
@pytest.mark.parametrize("seed", range(20))
def test_up_to_two_bad_fixes_do_not_matter(seed: int, sigma: float, with_velocity: bool) -> None:
    rng = np.random.default_rng((seed, 4))
    made = flown(spacing(seed), seed)
    r, v = measured(made, sigma, seed)
    bad = np.unique(np.r_[0, rng.integers(0, 8)] if seed % 3 else rng.integers(0, 8, 2))
    for k in bad:
        off = rng.standard_normal(3)
        off /= np.linalg.norm(off)
        kind = rng.integers(0, 3 if with_velocity else 2)
        if kind == 2:
            v[k] += 100.0 * off
        else:
            r[k] += off * (500.0, 1e5)[kind]
    start = orbit_start(
        made.t, r, v if with_velocity else None, sigma=sigma, sigma_velocity=0.01 * sigma
    )
    check(start, made, sigma, bad)


@pytest.mark.parametrize("off", [[500.0, 0, 0], [0, 0, -1e5], [-7e6, 0, 0], [1e9, 1e9, 0]])
@pytest.mark.parametrize("first", [0, 3, 7])
def test_one_bad_fix(off: list[float], first: int) -> None:
    made = flown(10.0 * np.arange(8), 5)
    for sigma in (1.0, 10.0):
        r, v = measured(made, sigma, 5)
        r[first] += off
        check(orbit_start(made.t, r, sigma=sigma), made, sigma, first)
        check(orbit_start(made.t, r, v, sigma=sigma), made, sigma, first)


def test_errors_are_those_of_the_fit() -> None:
    """The refined start is the least-squares orbit: its chi-square has mean 6."""
    force, t = orbit.ForceModel.j2(), 10.0 * np.arange(8)
    r0, v0 = random_orbit(np.random.default_rng(1))
    made = orbit.propagate(force, None, r0, v0, t, stm=True)
    assert made.stm is not None
    for width in (3, 6):
        noise = np.r_[np.full(3, 2.0), np.full(3, 0.02)][:width]
        rows = (made.stm[:, :width] / noise[:, None]).reshape(-1, 6)
        information = rows.T @ rows
        chi = []
        for seed in range(100):
            r, v = measured(made, 2.0, seed)
            start = orbit_start(
                t, r, v if width == 6 else None, sigma=2.0, sigma_velocity=0.02, accel_sigma=0.0
            )
            e = np.r_[start.r - r0, start.v - v0]
            chi.append(e @ information @ e)
        assert abs(np.mean(chi) - 6.0) < 5.0 * np.sqrt(2.0 * 6.0 / len(chi))


def test_false_marks_are_rare() -> None:
    marked = 0
    made = flown(10.0 * np.arange(8), 2)
    for seed in range(60):
        r, v = measured(made, 10.0, seed)
        marked += int((~orbit_start(made.t, r, v, sigma=10.0, sigma_velocity=0.1).good).sum())
        marked += int((~orbit_start(made.t, r, sigma=10.0).good).sum())
    assert marked <= 1


@pytest.mark.parametrize("with_velocity", [False, True])
@pytest.mark.parametrize("gap", [700.0, 2000.0, 5400.0])
def test_outages(gap: float, with_velocity: bool) -> None:
    t = np.r_[0.0, 10.0, 20.0, gap + 10.0 * np.arange(5)]
    made = flown(t, 5)  # in low orbit
    r, v = measured(made, 1.0, 5)
    r[0, 1] += 500.0
    start = orbit_start(t, r, v if with_velocity else None, sigma=1.0, sigma_velocity=0.01)
    assert start.good[3:].all()
    assert start.good.sum() >= 5
    assert np.linalg.norm(start.r - made.r[0]) < 500.0 + slack(t)


def test_fewest_fixes() -> None:
    made = flown(10.0 * np.arange(3), 6)
    r, v = measured(made, 1.0, 6)
    one = orbit_start(made.t[:1], r[:1], v[:1])
    np.testing.assert_allclose(np.r_[one.r, one.v], np.r_[r[0], v[0]], rtol=1e-9)
    two = orbit_start(made.t[:2], r[:2])
    np.testing.assert_allclose(two.r, r[0], atol=1e-2)
    assert np.linalg.norm(two.v - made.v[0]) < 1.0
    three = orbit_start(made.t, r, v, fixes=100)
    assert three.good.tolist() == [True] * 3
    r[1] += 500.0
    assert orbit_start(made.t, r, v).good.tolist() == [True, False, True]


def test_only_the_first_fixes_are_looked_at() -> None:
    made = flown(10.0 * np.arange(40), 7)
    r, _ = measured(made, 1.0, 7)
    start = orbit_start(made.t, r, fixes=5)
    np.testing.assert_array_equal(start.r, orbit_start(made.t[:5], r[:5]).r)
    assert len(start.good) == 5
    many = orbit_start(made.t, r, fixes=40)
    assert many.good.sum() >= 39


def test_another_force_model() -> None:
    made = flown(60.0 * np.arange(8), 8)
    r, v = measured(made, 1.0, 8)
    force = {"force": TRUTH, "tables": tables(), "accel_sigma": 1e-7}
    fine = orbit_start(made.t, r, v, sigma_velocity=0.01, **force)  # type: ignore[arg-type]
    r[3] += [0.0, 12.0, 0.0]  # too little for J2 to tell
    again = orbit_start(made.t, r, v, sigma_velocity=0.01, **force)  # type: ignore[arg-type]
    assert fine.good.all()
    assert again.good.tolist() == [k != 3 for k in range(8)]
    assert np.linalg.norm(fine.r - made.r[0]) < 4.0


def test_inputs_are_left_alone_and_the_answer_repeats() -> None:
    made = flown(10.0 * np.arange(8), 9)
    r, v = measured(made, 1.0, 9)
    before = r.copy(), v.copy()
    one, two = orbit_start(made.t, r, v), orbit_start(made.t, r, v)
    np.testing.assert_array_equal(one.r, two.r)
    np.testing.assert_array_equal(before[0], r)
    np.testing.assert_array_equal(before[1], v)


@pytest.mark.parametrize("sigma", [1.0, 10.0])
def test_the_published_experiment(sigma: float) -> None:
    """From the log itself: Earth-fixed fixes, a quarter of them outliers of 20 sigma and more."""
    scenario = GnssStarScenario(gnss_sigma=sigma, gnss_outliers=(0.25, 20.0, 200.0))
    found = 0
    for k in range(20):
        made = scenario.trial(8, k)
        table = made.log.gnss
        assert table is not None
        r, v = frames.to_gcrs(scenario.epoch, table.t, table.r, table.v)
        if made.gnss_outlier[:8].sum() > 3:
            continue
        start = orbit_start(table.t, r, v, sigma=sigma, sigma_velocity=0.01 * sigma)
        np.testing.assert_array_equal(start.good, ~made.gnss_outlier[:8])
        assert np.linalg.norm(start.r - made.r_i[0]) < 5.0 * sigma
        assert np.linalg.norm(start.v - made.v_i[0]) < 0.05 * sigma + 0.01
        found += 1
    assert found > 10
