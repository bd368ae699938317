"""Orbits from star angles: against plain filters, in pieces, and with what cannot be used."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.orbit import ForceModel, OrbitDynamics

R0, V0 = np.array([7.1e6, 0.0, 0.0]), np.array([0.0, 3.2e3, 6.75e3])
DYNAMICS = OrbitDynamics(ForceModel.j2(), 4e-7)
A, B = cc.StarHorizon(correlated=False), cc.StarHorizon()
MU, RE, J2 = 3.986004415e14, 6378136.3, ForceModel.j2()._field.j2


def unit(v):
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def truth(t):
    return cc.orbit.propagate(ForceModel.j2(), None, R0, V0, t, method="rk4", step=5.0)


def log_of(noise, *, steps=120, period=15.0, stars=5, seed=0, spoilt=0.0):
    """Angles to random stars about the zenith, with their errors by hand."""
    rng = np.random.default_rng(seed)
    t = np.arange(steps) * period
    orbit = truth(t)
    up = unit(orbit.r)[:, None, :]
    star = unit(up + 0.3 * rng.normal(size=(steps, stars, 3)))
    axes = np.linalg.svd(up)[2][:, 1:]
    tilt = noise.shared * rng.normal(size=(steps, 2))
    nadir = unit(-up[:, 0] + np.einsum("ki,kij->kj", tilt, axes))
    angle = np.arccos(np.einsum("kij,kj->ki", star, nadir))
    angle += noise.own * rng.normal(size=angle.shape)
    angle += (rng.random(angle.shape) < spoilt) * 50 * noise.own * rng.choice([-1, 1], angle.shape)
    columns = (np.repeat(t, stars), star.reshape(-1, 3), np.clip(angle, 0, np.pi).reshape(-1))
    return cc.CelestialLog(horizon=columns), orbit


def acceleration(r):
    d2 = r @ r
    k, s = 1.5 * J2 * RE**2 / d2, 5.0 * r[2] ** 2 / d2
    return -MU / d2**1.5 * r * (1.0 + k * (np.array([1.0, 1.0, 3.0]) - s))


def slope(y):
    return np.concatenate([y[3:], acceleration(y[:3])])


def rk4(y, h):
    k1 = slope(y)
    k2 = slope(y + h / 2 * k1)
    k3 = slope(y + h / 2 * k2)
    k4 = slope(y + h * k3)
    return y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)


def differences(f, x, steps):
    columns = []
    for j, h in enumerate(steps):
        e = np.zeros(len(x))
        e[j] = h
        columns.append((f(x + e) - f(x - e)) / (2 * h))
    return np.stack(columns, axis=1)


STEPS = [10.0] * 3 + [0.01] * 3


def added(q, dt):
    one = np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    return q * np.kron(one, np.eye(3))


def plain_ekf(log, noise, x, p, q):
    """Extended Kalman filter on the angles themselves, with their full covariance."""
    table, states, covariances = log.horizon, [], []
    for k, t in enumerate(table.epochs):
        if k:
            dt = t - table.epochs[k - 1]
            f = differences(lambda y, h=dt: rk4(y, h), x, STEPS)
            x, p = rk4(x, dt), f @ p @ f.T + added(q, dt)
        rows = table.t == t
        star, z = table.star[rows], table.angle[rows]

        def predicted(y, star=star):
            return np.arccos(-star @ unit(y[:3]))

        h = differences(predicted, x, STEPS)
        # gradients of the angles to the nadir direction, all of them of length one
        e = h[:, :3] * np.linalg.norm(x[:3])
        r = noise.own**2 * np.eye(len(z)) + noise.shared**2 * e @ e.T
        gain = p @ h.T @ np.linalg.inv(h @ p @ h.T + r)
        x = x + gain @ (z - predicted(x))
        p = p - gain @ h @ p
        states.append(x)
        covariances.append(p)
    return np.array(states), np.array(covariances)


@pytest.mark.parametrize("noise", [A, B], ids=["independent", "shared"])
def test_the_ekf_is_a_plain_ekf_on_the_angles_themselves(noise):
    log, _ = log_of(noise)
    start = np.concatenate([R0 + 500.0, V0 - 0.5])
    p0 = np.diag([1e6] * 3 + [1.0] * 3)
    states, covariances = plain_ekf(log, noise, start, p0, 4e-7)
    nav = cc.CelestialNavigator(cc.EKF(), DYNAMICS, noise)
    sol = nav.run(log, start[:3], start[3:], covariance=True)
    sigma = np.sqrt(np.diagonal(covariances, axis1=1, axis2=2))
    # the direction is fitted, where the plain filter linearises about the prediction
    assert np.abs((sol.state - states) / sigma).max() < 5e-3
    assert np.abs(sol.sigma / sigma - 1.0).max() < 1e-3
    assert np.abs(sol.covariance - covariances).max() < 2e-3 * np.abs(covariances).max()


@pytest.mark.parametrize("kind", [cc.UKF(), cc.SRUKF(), cc.IteratedEKF()], ids=lambda f: f.kind)
def test_all_kalman_filters_agree_where_all_is_nearly_linear(kind):
    log, _ = log_of(B)
    ekf = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B).run(log, R0 + 500.0, V0)
    other = cc.CelestialNavigator(kind, DYNAMICS, B).run(log, R0 + 500.0, V0)
    assert np.abs((other.state - ekf.state) / ekf.sigma).max() < 1e-2
    assert np.abs(other.sigma / ekf.sigma - 1.0).max() < 1e-3
    assert other.filter == kind.kind


def test_angles_one_by_one_say_the_same_as_together():
    log, _ = log_of(A)
    both = [
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, A, combine=combine).run(log, R0 + 500.0, V0)
        for combine in (True, False)
    ]
    assert np.abs((both[0].state - both[1].state) / both[0].sigma).max() < 1e-2
    assert len(both[1].nis) == len(log.horizon) == 5 * len(both[0].nis)
    assert set(both[1].dof) == {1}
    assert set(both[0].dof) == {2}


def test_the_score_filter_of_normal_noise_is_the_ekf_one_by_one():
    log, _ = log_of(A, steps=40)
    score = cc.CelestialNavigator(cc.ScoreEKF(), DYNAMICS, A).run(log, R0 + 500.0, V0)
    ekf = cc.CelestialNavigator(cc.EKF(), DYNAMICS, A, combine=False).run(log, R0 + 500.0, V0)
    np.testing.assert_allclose(score.state, ekf.state, rtol=1e-10)
    np.testing.assert_allclose(score.sigma, ekf.sigma, rtol=1e-8)


def test_the_smoother_knows_more_and_ends_like_the_filter():
    log, orbit = log_of(A, steps=400)
    nav = cc.CelestialNavigator(cc.UKF(), OrbitDynamics(ForceModel.j2(), 1e-10), A)
    run = nav.run(log, R0 + 500.0, V0)
    best = nav.smooth(log, R0 + 500.0, V0)
    assert best.smoothed
    assert not run.smoothed
    np.testing.assert_allclose(best.state[-1], run.state[-1], rtol=1e-12)
    assert (best.sigma[:-1] < run.sigma[:-1]).all()
    middle = slice(100, 300)
    errors = [np.linalg.norm(s.r - orbit.r, axis=1)[middle].mean() for s in (run, best)]
    assert errors[1] < 0.8 * errors[0]
    np.testing.assert_array_equal(best.nis, run.nis)


def test_errors_match_their_sigma():
    scores = []
    dynamics = OrbitDynamics(ForceModel.j2(), 1e-12)
    for seed in range(40):
        log, orbit = log_of(B, steps=60, seed=seed)
        rng = np.random.default_rng(1000 + seed)
        start = np.concatenate([R0, V0]) + rng.normal(size=6) * np.repeat([1e3, 1.0], 3)
        sol = cc.CelestialNavigator(cc.UKF(), dynamics, B).run(
            log, start[:3], start[3:], covariance=True
        )
        error = sol.state[-1] - orbit.state[-1]
        scores.append(error @ np.linalg.solve(sol.covariance[-1], error))
    # the mean of 40 chi-square numbers of 6: 6 ± 0.55
    assert abs(np.mean(scores) - 6.0) < 3 * np.sqrt(12.0 / 40)


def test_gate_and_huber_stand_outliers():
    log, orbit = log_of(A, steps=400, spoilt=0.05)
    error = {}
    for name, options in {"plain": {}, "gate": {"gate": 0.999}, "huber": {"huber": 1.5}}.items():
        sol = cc.CelestialNavigator(cc.UKF(), DYNAMICS, A, **options).run(log, R0 + 300.0, V0)
        error[name] = np.linalg.norm(sol.r - orbit.r, axis=1)[100:].mean()
        rejected = sol.counts["rejected"] / sol.counts["angles"]
        assert (0.035 < rejected < 0.07) if name == "gate" else rejected == 0.0
    assert error["gate"] < 0.5 * error["plain"]
    assert error["huber"] < 0.7 * error["plain"]


def test_a_stream_gives_what_a_run_gives():
    log, _ = log_of(B, steps=30)
    nav = cc.CelestialNavigator(cc.UKF(), DYNAMICS, B, gate=0.9999)
    sol = nav.run(log, R0 + 500.0, V0, covariance=True)
    state = nav.start(0.0, R0 + 500.0, V0)
    table = log.horizon
    for k, t in enumerate(table.epochs):
        state.predict(t)
        rows = table.t == t
        done = state.update_horizon(table.star[rows], table.angle[rows])
        assert done.accepted == sol.accepted[k]
        assert done.nis == pytest.approx(sol.nis[k], rel=1e-9)
        np.testing.assert_allclose(state.r, sol.r[k], rtol=1e-12)
        np.testing.assert_allclose(state.covariance, sol.covariance[k], rtol=1e-8, atol=1e-12)
    other = state.copy()
    other.predict(1e3)
    assert state.t == table.epochs[-1]
    assert other.sigma[0] > state.sigma[0]


def test_a_step_that_fails_leaves_a_stream_as_it_was():
    nav = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B)
    state = nav.start(10.0, R0, V0)
    with pytest.raises(cc.InputError, match="before the state's time"):
        state.predict(9.0)
    with pytest.raises(cc.InputError, match="norm"):
        state.update_horizon([[0.0, 0.0, 2.0]], [1.0])
    with pytest.raises(cc.InputError, match="StarRefraction"):
        state.update_refraction([[0.0, 0.0, 1.0]], [1e-3])
    assert state.t == 10.0
    np.testing.assert_array_equal(state.r, R0)
    with pytest.raises(cc.InputError, match="whole logs"):
        cc.CelestialNavigator(cc.IteratedEKF(), DYNAMICS, B).start(0.0, R0, V0)


def test_rows_are_where_they_were_asked_for():
    log, _ = log_of(B, steps=20)
    nav = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B)
    every = nav.run(log, R0, V0)
    third = nav.run(log, R0, V0, every=3)
    np.testing.assert_array_equal(third.t, every.t[::3])
    np.testing.assert_array_equal(third.state, every.state[::3])
    # times of one's own, between the epochs and beyond the last
    own = nav.run(log, R0, V0, t_output=[22.0, 30.0, 400.0])
    np.testing.assert_array_equal(own.t, [0.0, 22.0, 30.0, 400.0])
    np.testing.assert_allclose(own.r[2], every.r[2], atol=1e-3)
    assert own.final["t"] == 400.0
    # a start before the first epoch, and one after some of them
    early = nav.run(log, R0, V0, t0=-5.0)
    assert early.t[0] == -5.0
    assert len(early) == 21
    late = nav.run(log, R0, V0, t0=50.0)
    assert late.counts["outside"] == 4


def test_epochs_with_one_star_or_none_are_used_for_what_they_are():
    log, orbit = log_of(B, steps=50, stars=1)
    sol = cc.CelestialNavigator(cc.UKF(), DYNAMICS, B).run(log, R0 + 300.0, V0)
    assert set(sol.dof) == {1}
    assert sol.accepted.all()
    assert 0.4 < sol.nis.mean() < 1.8
    assert np.linalg.norm(sol.r[-1] - orbit.r[-1]) < 5 * np.linalg.norm(sol.sigma[-1, :3])
    gone = cc.CelestialLog(horizon=([0.0, 5.0], [[1.0, 0, 0]] * 2, [np.nan, 3.1]))
    assert gone.horizon.missing == 1
    assert cc.CelestialNavigator(cc.UKF(), DYNAMICS, B).run(gone, R0, V0).counts["missing"] == 1


def test_forces_that_need_an_epoch_get_theirs():
    dynamics = OrbitDynamics(ForceModel(8, sun=True, moon=True), 1e-9)
    nav = cc.CelestialNavigator(cc.EKF(), dynamics, B)
    log, _ = log_of(B, steps=5)
    with pytest.raises(cc.InputError, match="epoch"):
        nav.run(log, R0, V0)
    dated = cc.CelestialLog(horizon=log.horizon, epoch="2007-07-01T12:00:00")
    sol = nav.run(dated, R0, V0, t_output=[60.0])
    path = cc.orbit.propagate(
        dynamics.force, dated.epoch, sol.final["r"], sol.final["v"], [sol.final["t"], 3000.0]
    )
    # a gate that nothing passes leaves the prediction
    blind = cc.CelestialNavigator(cc.EKF(), dynamics, B, gate=1e-9)
    far = blind.run(dated, sol.final["r"], sol.final["v"], t0=60.0, t_output=[3000.0])
    assert far.counts["predicted_only"] == 1
    np.testing.assert_allclose(far.r[-1], path.r[-1], atol=1.0)


def test_taylor_steps_are_what_the_paper_prints():
    dynamics = OrbitDynamics(ForceModel.j2(), 1e-9, integrator="taylor")
    log = cc.CelestialLog(horizon=([40.0], [[0.0, 0.0, 1.0]], [1.0]))
    nav = cc.CelestialNavigator(cc.EKF(), dynamics, B, gate=1e-9)
    sol = nav.run(log, R0, V0, t0=0.0, covariance=True)
    assert sol.counts["rejected"] == 1
    y = np.concatenate([R0, V0])
    f = slope(y)
    jacobian = differences(slope, y, STEPS)
    np.testing.assert_allclose(sol.state[-1], y + 40.0 * f + 800.0 * jacobian @ f, rtol=1e-7)
    phi = np.eye(6) + 40.0 * jacobian
    p = phi @ np.diag([1e6] * 3 + [1.0] * 3) @ phi.T + added(1e-9, 40.0)
    np.testing.assert_allclose(sol.covariance[-1], p, rtol=1e-4, atol=1e-3)


def test_distributions_pay_when_they_are_known():
    errors = {}
    rng = np.random.default_rng(5)
    log, orbit = log_of(cc.StarHorizon(1e-12, 0.0), steps=300)
    sigma = A.own
    noise = sigma * np.sqrt(3.0) * rng.uniform(-1, 1, len(log.horizon))
    table = log.horizon
    spoilt = cc.CelestialLog(horizon=(table.t, table.star, np.clip(table.angle + noise, 0, np.pi)))
    uniform = cc.StarHorizon(correlated=False, distribution="uniform")
    for name, kind, sensor in (("ekf", cc.EKF(), A), ("score", cc.ScoreEKF(), uniform)):
        nav = cc.CelestialNavigator(kind, OrbitDynamics(ForceModel.j2(), 1e-10), sensor)
        sol = nav.run(spoilt, R0 + 300.0, V0)
        errors[name] = np.linalg.norm(sol.r - orbit.r, axis=1)[100:].mean()
    assert errors["score"] < 0.5 * errors["ekf"]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"r0": R0 / 1e3}, "kilometres"),
        ({"v0": V0 / 1e3}, "km/s"),
        ({"r0": R0 / 2}, "inside the Earth"),
        ({"r0": [np.nan, 0, 0]}, "finite"),
        ({"sigma0": (0.0, 1.0)}, "positive"),
        ({"sigma0": 3.0}, "needs"),
        ({"covariance0": -np.eye(6)}, "positive definite"),
        ({"covariance0": np.eye(6), "sigma0": (1.0, 1.0)}, "not both"),
        ({"t0": 1e9}, "after the log"),
        ({"every": 0}, "at least 1"),
        ({"t_output": [3.0, 2.0]}, "increase"),
        ({"progress": 3}, "callable"),
    ],
)
def test_a_start_that_cannot_be_is_refused(change, message):
    log, _ = log_of(B, steps=3)
    options = {"r0": R0, "v0": V0, **change}
    nav = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B)
    with pytest.raises((cc.InputError, cc.NumericalError), match=message):
        nav.run(log, **options)


@pytest.mark.parametrize(
    ("table", "message"),
    [
        (([0.0], [[1.0, 0.0, 0.0]], [90.0]), "radians"),
        (([0.0], [[1.0, 1.0, 0.0]], [1.0]), "norm"),
        (([1.0, 0.0], [[1.0, 0.0, 0.0]] * 2, [1.0, 1.0]), "goes back"),
        (([0.0, np.nan], [[1.0, 0.0, 0.0]] * 2, [1.0, 1.0]), "finite"),
        (([0.0], [[np.nan, 0.0, 0.0]], [1.0]), "finite"),
        (([0.0, 1.0], [[1.0, 0.0, 0.0]], [1.0]), "shape"),
        (7, "needs"),
    ],
)
def test_a_log_that_cannot_be_is_refused(table, message):
    with pytest.raises(cc.InputError, match=message):
        cc.CelestialLog(horizon=table)


def test_a_navigator_that_cannot_be_is_refused():
    with pytest.raises(cc.InputError, match="filter"):
        cc.CelestialNavigator(cc.InvariantEKF(), DYNAMICS, B)
    with pytest.raises(cc.InputError, match="not both"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, B, gate=0.99, huber=1.5)
    with pytest.raises(cc.InputError, match="combined"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, B, huber=1.5, combine=False)
    with pytest.raises(cc.InputError, match="probability"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, B, gate=1.5)
    with pytest.raises(cc.InputError, match="measurements"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, [])
    with pytest.raises(cc.InputError, match="one of each kind"):
        cc.CelestialNavigator(cc.EKF(), DYNAMICS, [B, A])
    with pytest.raises(cc.InputError, match="radians"):
        cc.StarHorizon(3.0)
    with pytest.raises(cc.InputError, match="correlated=False"):
        cc.StarHorizon(distribution="uniform")
    with pytest.raises(cc.InputError, match="integrator"):
        OrbitDynamics(ForceModel.j2(), 1.0, integrator="euler")
    with pytest.raises(cc.InputError, match="accel_psd"):
        OrbitDynamics(ForceModel.j2(), -1.0)


def test_a_solution_is_a_table():
    log, _ = log_of(B, steps=5)
    sol = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B).run(log, R0, V0)
    frame = sol.to_dataframe()
    assert list(frame.columns[:4]) == ["t", "x", "y", "z"]
    assert len(frame) == 5
    np.testing.assert_array_equal(frame["s_vz"], sol.sigma[:, 5])
    assert "5 rows, 25 angles, ekf" in repr(sol)


def test_epochs_without_a_star_are_predicted_and_counted():
    log, _ = log_of(B, steps=20)
    table = log.horizon
    seen = table.t != 45.0
    columns = (table.t[seen], table.star[seen], table.angle[seen])
    sparse = cc.CelestialLog(horizon=columns, times=table.epochs)
    sol = cc.CelestialNavigator(cc.EKF(), DYNAMICS, B, gate=0.9999).run(sparse, R0 + 300.0, V0)
    assert sol.counts["epochs"] == len(sol) == 20
    assert sol.counts["predicted_only"] == 1
    assert len(sol.measurement_t) == 19
    grown, before = sol.sigma[3, :3], sol.sigma[2, :3]
    assert (grown > before).any()


def test_the_score_filter_shares_what_is_shared():
    log, _ = log_of(B, steps=30)
    score, ekf = (
        cc.CelestialNavigator(kind, DYNAMICS, B).run(log, R0 + 300.0, V0)
        for kind in (cc.ScoreEKF(), cc.EKF())
    )
    np.testing.assert_allclose(score.state, ekf.state, rtol=1e-12)


def test_a_particle_filter_is_the_ukf_under_a_shared_error_too():
    log, _ = log_of(B, steps=200)
    ukf, upf = (
        cc.CelestialNavigator(kind, DYNAMICS, B).run(log, R0 + 300.0, V0)
        for kind in (cc.UKF(), cc.UPF())
    )
    assert np.abs(upf.r - ukf.r).max() < 1.0
