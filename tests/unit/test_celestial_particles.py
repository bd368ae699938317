"""Particle filters, and angles to the limb, through the navigator."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.orbit import ForceModel, OrbitDynamics

R0, V0 = np.array([7.1e6, 0.0, 0.0]), np.array([0.0, 3.2e3, 6.75e3])
DYNAMICS = OrbitDynamics(ForceModel.j2(), 4e-7)
NORMAL = cc.StarHorizon(correlated=False)
UNIFORM = cc.StarHorizon(correlated=False, distribution="uniform")


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def log_of(draw, *, limb=0.0, steps=120, period=15.0, stars=5, seed=0):
    rng = np.random.default_rng(seed)
    t = np.arange(steps) * period
    orbit = cc.orbit.propagate(ForceModel.j2(), None, R0, V0, t, method="rk4", step=5.0)
    up = unit(orbit.r)[:, None, :]
    star = unit(up + 0.3 * rng.normal(size=(steps, stars, 3)))
    angle = np.arccos(-np.einsum("kij,kj->ki", star, up[:, 0]))
    angle -= np.arcsin(limb / np.linalg.norm(orbit.r, axis=1))[:, None]
    angle += draw(rng, angle.shape)
    columns = (np.repeat(t, stars), star.reshape(-1, 3), np.clip(angle, 0, np.pi).reshape(-1))
    return cc.CelestialLog(horizon=columns), orbit


def normal(rng, shape):
    return NORMAL.own * rng.normal(size=shape)


def uniform(rng, shape):
    return NORMAL.own * np.sqrt(3.0) * rng.uniform(-1.0, 1.0, shape)


def run(kind, sensor, log, **options):
    return cc.CelestialNavigator(kind, DYNAMICS, sensor).run(log, R0 + 300.0, V0, **options)


def test_the_proposal_form_is_the_ukf_where_noise_is_normal():
    log, _ = log_of(normal)
    ukf, upf = run(cc.UKF(), NORMAL, log), run(cc.UPF(), NORMAL, log)
    assert np.abs(upf.r - ukf.r).max() < 1.0
    np.testing.assert_allclose(upf.sigma, ukf.sigma, rtol=1e-3)
    assert len(upf.ess) == len(upf.nis)
    assert upf.ess.mean() > 19.0
    assert len(ukf.ess) == 0


def test_the_proposal_form_gains_where_noise_is_uniform():
    log, orbit = log_of(uniform, steps=400)
    errors = {}
    for kind in (cc.UKF(), cc.UPF(particles=40)):
        sol = run(kind, UNIFORM, log)
        errors[kind.kind] = np.linalg.norm(sol.r - orbit.r, axis=1)[100:].mean()
    assert errors["upf"] < 0.9 * errors["ukf"]


def test_the_literal_form_collapses_and_a_bank_does_not():
    log, _ = log_of(normal, steps=60)
    literal, bank = (run(cc.UPF(form=form), NORMAL, log) for form in ("literal", "bank"))
    assert literal.ess[10:].mean() < 1.5
    assert bank.ess.mean() > 5.0
    ukf = run(cc.UKF(), NORMAL, log)
    assert np.abs((bank.r - ukf.r) / ukf.sigma[:, :3])[-1].max() < 0.5


@pytest.mark.parametrize(
    "kind",
    [cc.UPF(), cc.UPF(moves=2), cc.UPF(form="literal"), cc.UPF(form="bank"), cc.BootstrapPF(64)],
    ids=["proposal", "moves", "literal", "bank", "bootstrap"],
)
def test_a_seed_gives_the_same_bits_and_another_seed_others(kind):
    log, _ = log_of(normal, steps=20)
    one, again = (run(kind, NORMAL, log, seed=3, trial=1) for _ in range(2))
    np.testing.assert_array_equal(one.state, again.state)
    other = run(kind, NORMAL, log, seed=3, trial=2)
    assert not np.array_equal(one.state, other.state)
    assert one.final["t"] == other.final["t"]


@pytest.mark.parametrize("way", ["systematic", "stratified", "residual", "multinomial"])
def test_every_way_to_resample_runs(way):
    log, orbit = log_of(normal, steps=20)
    sol = run(cc.BootstrapPF(2000, resampling=way), NORMAL, log)
    assert np.linalg.norm(sol.r[-1] - orbit.r[-1]) < 5e3


def test_weights_that_vanish_are_an_error_or_are_recovered_from():
    log, _ = log_of(uniform, steps=5)
    table = log.horizon
    # hard edges, and a start far from every angle
    sharp = cc.StarHorizon(correlated=False, distribution="uniform", edge=1e-200)
    spoilt = cc.CelestialLog(horizon=(table.t, table.star, np.clip(table.angle - 0.05, 0, np.pi)))
    strict = cc.CelestialNavigator(cc.BootstrapPF(50, recover=False), DYNAMICS, sharp)
    with pytest.raises(cc.NumericalError, match="measurement"):
        strict.run(spoilt, R0, V0)
    lenient = cc.CelestialNavigator(cc.BootstrapPF(50), DYNAMICS, sharp)
    with pytest.warns(cc.CelestcoreWarning, match="no particle explained 5 of 5"):
        sol = lenient.run(spoilt, R0, V0)
    assert sol.counts["recovered"] == 5
    assert np.isfinite(sol.state).all()


def test_particles_neither_smooth_nor_stream():
    log, _ = log_of(normal, steps=3)
    nav = cc.CelestialNavigator(cc.UPF(), DYNAMICS, NORMAL)
    with pytest.raises(cc.InputError, match="smooth the UKF"):
        nav.smooth(log, R0, V0)
    with pytest.raises(cc.InputError, match="whole logs"):
        nav.start(0.0, R0, V0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: cc.UPF(particles=0), "particles"),
        (lambda: cc.UPF(particles=2.5), "whole"),
        (lambda: cc.UPF(form="other"), "form"),
        (lambda: cc.UPF(moves=-1), "moves"),
        (lambda: cc.BootstrapPF(threshold=2.0), "threshold"),
        (lambda: cc.BootstrapPF(resampling="none"), "resampling"),
        (lambda: cc.StarHorizon(limb=6.4e6), "correlated=False"),
        (lambda: cc.StarHorizon(limb=6.4e3, correlated=False), "limb"),
    ],
)
def test_settings_that_cannot_be_are_refused(make, message):
    with pytest.raises(cc.InputError, match=message):
        make()


def test_angles_to_the_limb_also_tell_the_distance():
    limb = 6378137.0 + 40e3
    log, orbit = log_of(normal, limb=limb)
    to_limb = cc.StarHorizon(correlated=False, limb=limb)
    to_nadir = run(cc.EKF(), NORMAL, log_of(normal)[0])
    sol = run(cc.EKF(), to_limb, log)
    error = (sol.r - orbit.r) / sol.sigma[:, :3]
    assert np.sqrt(np.mean(error**2)) < 2.0
    assert 0.9 < sol.nis.mean() < 1.1
    assert set(sol.dof) == {1}
    # half a minute in, where dynamics has not had the time to tell it
    up = unit(orbit.r[2])
    radial = [np.sqrt(up**2 @ s.sigma[2, :3] ** 2) for s in (sol, to_nadir)]
    assert radial[0] < radial[1]
    # what is taken for an angle to the nadir is 65 degrees off
    with pytest.warns(cc.CelestcoreWarning, match="outside the gate"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, NORMAL, gate=0.9999).run(log, R0, V0)
