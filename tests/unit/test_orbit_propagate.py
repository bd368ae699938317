"""Propagation: laws, bad input, and what a trajectory can do."""

from __future__ import annotations

import numpy as np
import orbit_tables as ref
import pytest
from celestcore import orbit
from celestcore.errors import InputError, NumericalError
from celestcore.orbit import ForceModel, propagate

ENV = ref.tables()
R0, V0 = ref.start()
T = np.arange(0.0, 6001.0, 60.0)


def test_the_high_fidelity_orbit_does_not_depend_on_method_or_output() -> None:
    model = ForceModel.high_fidelity()
    fine = propagate(model, ref.EPOCH, R0, V0, T, environment=ENV, rtol=1e-13)
    assert len(fine) == len(T)
    assert (fine.r[0] == R0).all()
    assert (fine.v[0] == V0).all()
    ends = propagate(model, ref.EPOCH, R0, V0, T[[0, -1]], environment=ENV, rtol=1e-13)
    assert (ends.r[-1] == fine.r[-1]).all()
    # RK4 does not stop at the shadow's edges: 1e-7 m/s^2 misplaced by less than a step
    slow = propagate(model, ref.EPOCH, R0, V0, T, environment=ENV, method="rk4", step=1.0)
    assert np.linalg.norm(slow.r - fine.r, axis=1).max() < 2e-3


def test_an_orbit_in_and_out_of_the_shadow_comes_back() -> None:
    model = ForceModel("j2", srp=orbit.SolarPressure())
    there = propagate(model, ref.EPOCH, R0, V0, [0.0, 36_000.0], environment=ENV, rtol=1e-13)
    back = propagate(
        model, ref.EPOCH, there.r[-1], there.v[-1], [36_000.0, 0.0], environment=ENV, rtol=1e-13
    )
    assert np.linalg.norm(back.r[-1] - R0) < 1e-3


def test_jacobis_integral_is_kept_by_a_turning_zonal_field() -> None:
    out = propagate(ForceModel.j2(), None, R0, V0, np.arange(0.0, 36_001.0, 600.0))
    r = np.linalg.norm(out.r, axis=1)
    field = orbit.GravityField.jgm3()
    sin2 = (out.r[:, 2] / r) ** 2
    potential = field.mu / r * (1 - field.j2 * (field.radius / r) ** 2 * (1.5 * sin2 - 0.5))
    energy = 0.5 * (out.v**2).sum(axis=1) - potential
    assert np.ptp(energy) < 1e-11 * abs(energy[0])
    polar = np.cross(out.r, out.v)[:, 2]
    assert np.ptp(polar) < 1e-11 * abs(polar[0])


def test_a_state_transition_maps_small_differences() -> None:
    out = propagate(ForceModel(8), ref.EPOCH, R0, V0, T, environment=ENV, stm=True)
    assert out.stm is not None
    assert out.stm.shape == (len(T), 6, 6)
    d = np.array([3.0, -2.0, 1.0, 2e-3, 1e-3, -3e-3])
    plus, minus = (
        propagate(ForceModel(8), ref.EPOCH, R0 + s * d[:3], V0 + s * d[3:], T, environment=ENV)
        for s in (1.0, -1.0)
    )
    moved = 0.5 * (plus.state - minus.state)
    assert np.abs((out.stm @ d - moved)[:, :3]).max() < 1e-3
    plain = propagate(ForceModel(8), ref.EPOCH, R0, V0, T, environment=ENV)
    assert np.abs(plain.r - out.r).max() < 1e-5
    # Hamiltonian flow: symplectic
    j = np.block([[np.zeros((3, 3)), np.eye(3)], [-np.eye(3), np.zeros((3, 3))]])
    scale = np.diag([1e3] * 3 + [1.0] * 3)
    phi = np.linalg.inv(scale) @ out.stm[-1] @ scale
    assert np.abs(phi.T @ j @ phi - j).max() < 1e-8 * np.abs(phi).max() ** 2


def test_a_trajectory_is_indexed_like_an_array() -> None:
    out = propagate(ForceModel.j2(), "2007-07-01T12:00:00", R0, V0, T, stm=True)
    assert out.epoch == "2007-07-01T12:00:00"
    assert len(out[10:20]) == 10
    assert (out[T > 3000.0].t == T[T > 3000.0]).all()
    assert out[-1].r.shape == (1, 3)
    assert out[3].stm is not None
    assert (out.state[:, 3:] == out.v).all()


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"r0": R0 / 1e3}, "multiply by 1000"),
        ({"v0": V0 / 1e3}, "km/s"),
        ({"r0": 0.8 * R0}, "inside the Earth"),
        ({"r0": [np.nan, 7e6, 0]}, "finite"),
        ({"r0": [7e6, 0]}, "shape"),
        ({"t": []}, "empty"),
        ({"t": [0.0, 2.0, 1.0, 3.0]}, "row 2"),
        ({"t": [0.0, np.inf]}, "finite"),
        ({"t": [0.0, 1e7]}, "environment"),
        ({"rtol": 0.0}, "rtol"),
        ({"rtol": 0.1}, "rtol"),
        ({"step": -1.0}, "step"),
        ({"method": "euler"}, "'dop853' or 'rk4'"),
        ({"epoch": None, "environment": None}, "epoch"),
        ({"model": 21}, "ForceModel"),
    ],
)
def test_bad_input_is_named(change: dict[str, object], what: str) -> None:
    good = {"model": ForceModel(8), "epoch": ref.EPOCH, "r0": R0, "v0": V0, "t": T}
    with pytest.raises(InputError, match=what):
        propagate(**{"environment": ENV, **good, **change})  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["dop853", "rk4"])
def test_a_fall_into_the_earth_is_an_error(method: str) -> None:
    with pytest.raises(NumericalError, match="inside") as caught:
        propagate(ForceModel.j2(), None, R0, 0 * V0, [0.0, 7200.0], method=method)  # type: ignore[arg-type]
    assert caught.value.time is not None
    assert 0 < caught.value.time < 2500


def test_tables_that_do_not_fit_are_refused() -> None:
    for name, value in (
        ("cip", ENV["cip"][:-1]),
        ("sun", np.full_like(ENV["sun"], np.nan)),
        ("earth_t", ENV["earth_t"] ** 2),
    ):
        with pytest.raises(InputError, match="environment"):
            propagate(ForceModel(2), None, R0, V0, T, environment={**ENV, name: value})
    tables = {k: v for k, v in ENV.items() if k != "moon"}
    with pytest.raises(InputError, match="moon is missing"):
        propagate(ForceModel(2), None, R0, V0, T, environment=tables)
