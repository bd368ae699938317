"""Bounds against the information of all measurements mapped to the start, and trades."""

from __future__ import annotations

import dataclasses

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import Trade, posterior_bound, trade
from celestcore.analysis.bound import informative
from celestcore.errors import InputError
from numpy.typing import NDArray
from scipy.integrate import quad
from scipy.stats import t as student

Array = NDArray[np.float64]
R0, V0 = [7e6, 0.0, 1e5], [100.0, 4e3, 6.4e3]
START = (1e3, 1.0)
J2 = cc.orbit.ForceModel.j2()
PERFECT = cc.orbit.OrbitDynamics(J2, 0.0, max_step=10.0)


def flight(period: float = 60.0, hours: float = 3.0) -> cc.orbit.Trajectory:
    t = np.arange(0.0, 3600.0 * hours + 1.0, period)
    return cc.orbit.propagate(J2, "2007-07-01T12:00:00", R0, V0, t, stm=True)


def scenario(horizon: cc.StarHorizon, **options: float) -> cc.celestial.Scenario:
    camera = cc.celestial.SkyCamera(cc.StarCatalogue.random(5000, seed=3))
    return cc.celestial.Scenario(flight(), camera, horizon, period=60.0, start_sigma=START)


def information(made: cc.celestial.Scenario, own: float, shared: float) -> tuple[Array, Array]:
    """Return the covariances (n, 6, 6) of filter and smoother by normal equations at the start.

    Everything is mapped there by the integrated transition matrices: no filter in it.
    """
    truth, stars = flight(), made.stars
    scale = np.repeat(START, 3)
    f = truth.stm * scale
    total, after = np.eye(6), []
    for k in range(len(truth)):
        s = stars.star[stars.epoch == k]
        if len(s):
            r = np.linalg.norm(truth.r[k])
            u = -truth.r[k] / r
            e = s - (s @ u)[:, None] * u
            e /= np.linalg.norm(e, axis=1)[:, None]
            h = np.hstack([e / r, np.zeros((len(s), 3))]) @ f[k]
            noise = own**2 * np.eye(len(s)) + shared**2 * e @ e.T
            total = total + h.T @ np.linalg.solve(noise, h)
        after.append(f[k] @ np.linalg.solve(total, f[k].T))
    return np.array(after), f @ np.linalg.inv(total) @ np.swapaxes(f, 1, 2)


@pytest.mark.parametrize("correlated", [True, False])
def test_bound_is_the_inverse_of_all_information(correlated: bool) -> None:
    horizon = cc.StarHorizon(correlated=correlated)
    made = scenario(horizon)
    causal, smoothed = information(made, horizon.own, horizon.shared)
    for smoother, wanted in ((False, causal), (True, smoothed)):
        found = posterior_bound(made, PERFECT, smoother=smoother)
        np.testing.assert_array_equal(found.t, made.truth.t)
        sigma = np.sqrt(np.diagonal(found.covariance, axis1=1, axis2=2))
        known = np.sqrt(np.diagonal(wanted, axis1=1, axis2=2))
        np.testing.assert_allclose(sigma, known, rtol=2e-4)
        lengths = np.sqrt(np.trace(wanted[:, :3, :3], axis1=1, axis2=2))
        np.testing.assert_allclose(found.position, lengths, rtol=2e-4)


def test_smoother_knows_more_and_both_agree_at_the_end() -> None:
    made = scenario(cc.StarHorizon())
    causal, smoothed = (posterior_bound(made, PERFECT, smoother=s) for s in (False, True))
    assert np.all(smoothed.position < causal.position * (1.0 + 1e-9))
    assert smoothed.position[-1] == pytest.approx(causal.position[-1], rel=1e-9)
    assert smoothed.rms()[0] < 0.7 * causal.rms()[0]
    assert causal.rms(skip=7200.0)[0] < causal.rms()[0]


def test_noise_in_the_dynamics_loosens_the_bound() -> None:
    made = scenario(cc.StarHorizon())
    bounds = [
        posterior_bound(made, cc.orbit.OrbitDynamics(J2, q)).position[-1] for q in (0.0, 1e-9, 1e-6)
    ]
    assert bounds[0] < bounds[1] < bounds[2]


def test_dynamics_are_perfect_unless_given() -> None:
    made = scenario(cc.StarHorizon())
    found = posterior_bound(made).rms(3600.0)[0]
    assert found == pytest.approx(posterior_bound(made, PERFECT).rms(3600.0)[0], rel=0.01)
    timeless = dataclasses.replace(made, orbit=dataclasses.replace(made.orbit, epoch=None))
    assert posterior_bound(timeless).rms(3600.0)[0] == pytest.approx(found, rel=0.01)


@pytest.mark.parametrize("dof", [3.0, 5.0, 30.0])
def test_fisher_information_of_student_noise(dof: float) -> None:
    """Against the integral of the squared score."""
    horizon = cc.StarHorizon(1e-3, 0.0, correlated=False, distribution="student_t", dof=dof)
    scale = 1e-3 * np.sqrt((dof - 2.0) / dof)

    def integrand(x: float) -> float:
        score = (dof + 1.0) * x / (dof + x * x)
        return float(score**2 * student.pdf(x, dof))

    fisher = quad(integrand, -np.inf, np.inf)[0] / scale**2
    assert informative(horizon).own == pytest.approx(fisher**-0.5, rel=1e-7)


def test_student_noise_is_worth_more_than_normal_noise() -> None:
    normal = cc.StarHorizon(correlated=False)
    student_t = cc.StarHorizon(correlated=False, distribution="student_t")
    ratio = [posterior_bound(scenario(h), PERFECT).position[-1] for h in (student_t, normal)]
    assert ratio[0] / ratio[1] == pytest.approx(np.sqrt(0.5), rel=0.02)


def test_no_bound_for_uniform_noise() -> None:
    uniform = cc.StarHorizon(correlated=False, distribution="uniform")
    with pytest.raises(InputError, match="no Cramer-Rao bound"):
        posterior_bound(scenario(uniform), PERFECT)


def test_bad_arguments() -> None:
    made = scenario(cc.StarHorizon())
    with pytest.raises(InputError, match="skip"):
        posterior_bound(made, PERFECT).rms(1e6)
    with pytest.raises(InputError, match="scenario"):
        posterior_bound("no", PERFECT)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="dynamics"):
        posterior_bound(made, J2)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def found() -> Trade:
    sky = cc.StarCatalogue.random(5000, seed=3)
    up = cc.celestial.SkyCamera(sky)
    cameras = {
        "six": up,
        "three": cc.celestial.SkyCamera(sky, brightest=3),
        "side": cc.celestial.SkyCamera(sky, boresight=(0.0, -1.0, -1.0)),
        "both": [up, cc.celestial.SkyCamera(sky, boresight=(0.0, -1.0, -1.0))],
    }
    dynamics = {"right": cc.orbit.OrbitDynamics(J2, 1e-12)}
    dynamics["two-body"] = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.two_body(), 1e-5)
    return trade(
        flight(),
        cameras,
        cc.StarHorizon(correlated=False),
        [60.0, 240.0],
        dynamics,
        runs=12,
        seed=5,
        skip=3600.0,
    )


def test_trade_says_what_pays(found: Trade) -> None:
    six, three, side, both = range(4)
    assert found.stars[six] == pytest.approx(6.0, abs=0.3)
    assert found.stars[both] == pytest.approx(found.stars[six] + found.stars[side])
    assert np.all(found.bound[three] > 1.3 * found.bound[six])
    assert np.all(found.bound[side] > 1.3 * found.bound[six])  # one axis of the nadir, mostly
    assert np.all(found.bound[both] < found.bound[six])
    assert np.all(found.bound[:, 1] > 1.5 * found.bound[:, 0])  # four times fewer angles
    right, two_body = found.rms[:, :, 0], found.rms[:, :, 1]
    assert np.all(two_body > 1.2 * right)
    assert np.all(np.abs(right - found.bound) < 4.0 * found.error[:, :, 0])
    assert np.abs(found.nees[:, :, 0].mean() / 6.0 - 1.0) < 0.2


def test_trade_as_rows(found: Trade) -> None:
    rows = found.rows()
    assert len(rows) == 4 * 2 * 2
    last = rows[-1]
    assert (last["camera"], last["period_s"], last["dynamics"]) == ("both", 240.0, "two-body")
    assert last["rms_m"] == found.rms[3, 1, 1]
    assert last["bound_m"] == found.bound[3, 1]


def test_plot_trade(found: Trade) -> None:
    pytest.importorskip("matplotlib")
    fig = cc.analysis.plot_trade(found)
    assert [ax.get_title(loc="left").split(":")[0] for ax in fig.axes] == list(found.cameras)
    labels = [text.get_text() for text in fig.axes[0].get_legend().get_texts()]
    assert labels == ["bound of any filter", "right", "two-body"]


@pytest.mark.parametrize(
    ("field", "change"),
    [
        ("cameras", {"cameras": {}}),
        ("dynamics", {"dynamics": {}}),
        ("periods", {"periods": []}),
        ("runs", {"runs": 0}),
    ],
)
def test_trade_refuses(field: str, change: dict[str, object]) -> None:
    sky = cc.celestial.SkyCamera(cc.StarCatalogue.random(100))
    given = {"orbit": flight(), "cameras": {"up": sky}, "horizon": cc.StarHorizon(), **change}
    with pytest.raises(InputError, match=field):
        trade(**given)  # type: ignore[arg-type]
