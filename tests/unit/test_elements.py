"""Orbital elements against closed forms, scipy's roots and an integrated orbit."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore import elements
from celestcore.elements import MU, Elements
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

RNG = np.random.default_rng(20)


def near(a: np.ndarray, b: np.ndarray, rtol: float) -> bool:
    """Compare vectors by the length of their difference."""
    size = np.linalg.norm(b, axis=-1)
    return bool((np.linalg.norm(a - b, axis=-1) <= rtol * size).all())


def random_orbits(n: int, e: np.ndarray) -> Elements:
    p = RNG.uniform(6.6e6, 3e7, n)
    limit = np.where(e > 1.0, np.arccos(-1.0 / np.maximum(e, 1.0)) - 0.05, np.pi)
    limit = np.where(np.abs(e - 1.0) < 0.01, 2.9, limit)  # a parabola's other end is infinitely far
    with np.errstate(divide="ignore"):
        a = np.where(e == 1.0, np.inf, p / (1.0 - e * e))
    return Elements(
        a=a,
        e=e,
        i=RNG.uniform(0.0, np.pi, n),
        raan=RNG.uniform(0.0, 2 * np.pi, n),
        argp=RNG.uniform(0.0, 2 * np.pi, n),
        nu=RNG.uniform(-limit, limit),
        p=p,
    )


CONICS = {
    "ellipses": RNG.uniform(0.0, 0.99, 2000),
    "nearly circular": 10.0 ** RNG.uniform(-10, -2, 2000),
    "parabolas": np.ones(500),
    "nearly parabolic": 1.0 + RNG.choice([-1, 1], 1000) * 10.0 ** RNG.uniform(-12, -3, 1000),
    "hyperbolas": RNG.uniform(1.01, 8.0, 2000),
}


@pytest.mark.parametrize("kind", CONICS)
def test_state_to_elements_and_back(kind: str) -> None:
    e = CONICS[kind]
    orbit = random_orbits(len(e), e)
    r, v = elements.to_state(orbit)
    got = elements.from_state(r, v)
    again = elements.to_state(got)
    assert near(again[0], r, 3e-14)
    assert near(again[1], v, 3e-14)
    assert np.abs(got.e - e).max() < 1e-13
    assert np.allclose(got.p, orbit.p, rtol=1e-13)
    assert np.allclose(got.i, orbit.i, rtol=0, atol=1e-13)
    # angles by their distance on the circle; the perigee of a small ellipse is worth 1/e less
    sharp = 1e-12 / np.minimum(e, 1.0) / np.sin(orbit.i)
    for name in ("raan", "argp", "nu"):
        apart = getattr(got, name) - getattr(orbit, name)
        assert (np.abs(np.exp(1j * apart) - 1.0) < sharp).all(), name
        assert (getattr(got, name) >= 0.0).all()
        assert (getattr(got, name) < 2 * np.pi).all()


def test_elements_say_what_they_mean() -> None:
    """Energy, angular momentum, perigee and node of the state, computed apart."""
    orbit = random_orbits(300, RNG.uniform(0.05, 0.9, 300))
    r, v = elements.to_state(orbit)
    h, radius = np.cross(r, v), np.linalg.norm(r, axis=1)
    assert np.allclose(0.5 * (v**2).sum(axis=1) - MU / radius, -0.5 * MU / orbit.a, rtol=1e-12)
    assert np.allclose(np.linalg.norm(h, axis=1), np.sqrt(MU * orbit.p), rtol=1e-13)
    perigee = np.cross(v, h) / MU - r / radius[:, None]
    assert np.allclose(np.linalg.norm(perigee, axis=1), orbit.e, rtol=0, atol=1e-12)
    assert np.allclose(h[:, 2], np.linalg.norm(h, axis=1) * np.cos(orbit.i), rtol=1e-12, atol=1e-2)
    crossing, up = elements.to_state(orbit._replace(nu=-orbit.argp))
    assert np.abs(crossing[:, 2]).max() < 1e-7
    assert (up[:, 2] > 0.0).all()
    angle = np.arctan2(crossing[:, 1], crossing[:, 0])
    assert np.abs(np.exp(1j * (angle - orbit.raan)) - 1.0).max() < 1e-13


def test_circular_and_equatorial_conventions() -> None:
    speed = float(np.sqrt(MU / 7e6))
    tilted = elements.from_state([0.0, 7e6, 0.0], [-speed * 0.6, 0.0, speed * 0.8])
    assert tilted.e < 1e-13
    assert tilted.argp == 0.0
    assert tilted.raan == pytest.approx(np.pi / 2)
    flat = elements.from_state([0.0, 7e6, 0.0], [-speed * 1.1, 0.0, 0.0])
    assert (flat.raan, flat.i) == (0.0, 0.0)
    assert flat.argp == pytest.approx(np.pi / 2)
    back = elements.from_state([0.0, 7e6, 0.0], [speed * 1.1, 0.0, 0.0])
    assert (back.raan, back.i) == (0.0, pytest.approx(np.pi))
    for state in (
        ([0.0, 7e6, 0.0], [speed * 1.1, 0.0, 0.0]),
        ([0.0, 7e6, 0.0], [-speed, 0.0, 0.0]),
        ([3e6, 7e6, 0.0], [speed, -0.2 * speed, 1e-9]),
    ):
        r, v = elements.to_state(elements.from_state(*state))
        assert near(r, np.array(state[0]), 2e-13)  # an inclination below 1e-13 has no node
        assert near(v, np.array(state[1]), 1e-12)


def test_two_body_motion_is_what_integration_gives() -> None:
    for e in (0.0, 0.3, 0.95, 1.0, 2.5):
        orbit = random_orbits(1, np.array([e]))
        r, v = elements.to_state(orbit)

        def fall(_: float, y: np.ndarray) -> np.ndarray:
            return np.concatenate([y[3:], -MU * y[:3] / np.linalg.norm(y[:3]) ** 3])

        y0 = np.concatenate([r[0], v[0]])
        path = solve_ivp(fall, (0.0, 4000.0), y0, method="DOP853", rtol=1e-13, atol=1e-6)
        later_r, later_v = elements.to_state(elements.two_body(orbit, 4000.0))
        assert near(later_r[0], path.y[:3, -1], 1e-10), e
        assert near(later_v[0], path.y[3:, -1], 1e-10), e
    batch = elements.two_body(Elements(7e6, 0.1, 1.0, 0.0, 0.0, 0.0), np.linspace(0, 6000, 5))
    assert batch.nu.shape == (5,)
    assert (np.diff(batch.nu) > 0).all()


@pytest.mark.parametrize("e", [0.0, 1e-3, 0.5, 0.9, 0.999, 1 - 1e-9, 1.0, 1 + 1e-9, 1.1, 3.0, 50.0])
def test_keplers_equation_against_bisection(e: float) -> None:
    mean = np.concatenate([[0.0], 10.0 ** np.linspace(-8, 0.49, 60)])
    true = elements.mean_to_true(mean, e)
    assert np.array_equal(elements.mean_to_true(-mean, e), -true)
    for m, nu in zip(mean[1:], true[1:], strict=True):
        if e < 1.0:
            root = brentq(lambda x, m=m: x - e * np.sin(x) - m, 0, 4, xtol=1e-300, rtol=1e-15)
            want = 2 * np.arctan(np.sqrt((1 + e) / (1 - e)) * np.tan(root / 2))
        elif e > 1.0:
            root = brentq(lambda x, m=m: e * np.sinh(x) - x - m, 0, 9, xtol=1e-300, rtol=1e-15)
            want = 2 * np.arctan(np.sqrt((e + 1) / (e - 1)) * np.tanh(root / 2))
        else:
            root = brentq(lambda x, m=m: x + x**3 / 3 - m, 0, 4, xtol=1e-300, rtol=1e-15)
            want = 2 * np.arctan(root)
        # next to a parabola the plain E - e sin E of this test cancels
        assert nu == pytest.approx(want, rel=1e-12 if abs(e - 1) > 1e-6 or e == 1 else 1e-3)
    back = elements.true_to_mean(true, e)
    rounding = np.abs(1.0 - e * e) ** 1.5 / (1.0 + e * np.cos(true)) ** 2 * 1e-15
    if e == 1.0:
        rounding = 0.0 * mean
    assert (np.abs(back - mean) <= 1e-13 * mean + rounding).all()


def test_anomalies_keep_their_revolution() -> None:
    nu = np.linspace(-20.0, 20.0, 1001)
    mean = elements.true_to_mean(nu, 0.7)
    assert (np.diff(mean) > 0).all()
    assert np.allclose(elements.mean_to_true(mean, 0.7), nu, rtol=0, atol=1e-13)


def test_period_and_mean_motion() -> None:
    assert elements.period(7136.635e3) == pytest.approx(6000.0, abs=0.01)
    assert elements.mean_motion([7e6, 8e6]).shape == (2,)
    assert elements.period(1.0, mu=4 * np.pi**2) == pytest.approx(1.0)


def test_what_is_no_orbit_is_refused() -> None:
    r, v = elements.to_state(Elements(-8e6, 2.0, 0.1, 0.0, 0.0, 0.0))
    with pytest.raises(cc.InputError, match=r"a, row 1, value -[78].*only an ellipse"):
        elements.period([7e6, elements.from_state(r, v).a])
    with pytest.raises(cc.InputError, match="only an ellipse"):
        elements.mean_motion(np.inf)
    with pytest.raises(cc.InputError, match=r"v, row 1.*no orbital plane"):
        elements.from_state([[7e6, 0, 0], [7e6, 0, 0]], [[0, 7e3, 0], [7e3, 0, 0]])
    with pytest.raises(cc.InputError, match=r"r, row 0.*finite"):
        elements.from_state([[np.nan, 0, 0]], [[0, 7e3, 0]])
    with pytest.raises(cc.InputError, match="last axis of 3"):
        elements.from_state([7e6, 0.0], [0.0, 7e3])
    for bad, says in {
        Elements(7e6, 1.5, 0, 0, 0, 0): "negative for e > 1",
        Elements(-7e6, 0.5, 0, 0, 0, 0): "negative for e > 1",
        Elements(7e6, -0.1, 0, 0, 0, 0): "e, .*not be negative",
        Elements(np.inf, 1.0, 0, 0, 0, 0): "parabola needs p",
        Elements(-7e6, 1.5, 0, 0, 0, 2.5): "asymptote",
        Elements(7e6, 0.1, np.nan, 0, 0, 0): "i, .*finite",
    }.items():
        with pytest.raises(cc.InputError, match=says):
            elements.to_state(bad)
    with pytest.raises(cc.InputError, match="broadcast"):
        elements.mean_to_true([1.0, 2.0], [0.1, 0.2, 0.3])
    with pytest.raises(cc.InputError, match="asymptote"):
        elements.true_to_mean(3.0, 2.0)


def test_kilometres_are_found_out():
    with pytest.raises(cc.InputError, match="kilometres"):
        elements.from_state([7000.0, 0.0, 0.0], [0.0, 7.5, 0.0])
    with pytest.raises(cc.InputError, match="kilometres"):
        elements.to_state(elements.Elements(7000.0, 0.0, 1.0, 0.0, 0.0, 0.0))
    # other bodies and other units are the caller's
    r, _ = elements.to_state(elements.Elements(7000.0, 0.0, 1.0, 0.0, 0.0, 0.0), mu=398600.4415)
    assert np.linalg.norm(r) == pytest.approx(7000.0)
