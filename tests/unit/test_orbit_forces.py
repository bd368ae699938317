"""Forces on a satellite against slow references, ERFA and closed forms."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import celestcore as cc
import numpy as np
import orbit_tables as ref
import pytest
from celestcore import _core
from celestcore.errors import InputError
from celestcore.orbit import Drag, ForceModel, GravityField, SolarPressure

ENV = ref.tables()
JGM3 = GravityField.jgm3()
ROTATION = ref.gcrs_to_itrs(0.0)


def pull(model: ForceModel, r: np.ndarray, v: object = (0.0, 0.0, 0.0)) -> np.ndarray:
    return model.acceleration([0.0], [r], [v], environment=ENV)[0]


@pytest.mark.parametrize("t", [0.0, 100.0, 12_345.6, 36_000.0])
def test_the_tables_give_erfas_rotation(t: float) -> None:
    rotation, sun, moon = _core.orbit_moments(ENV, np.array([t]))
    assert np.abs(rotation[0] - ref.gcrs_to_itrs(t)).max() < 2e-14
    assert np.abs(sun[0] - ref.sun(np.array([t]))[0]).max() < 0.01
    assert np.abs(moon[0] - ref.moon(np.array([t]))[0]).max() < 2.0


@pytest.mark.parametrize(
    ("degree", "order"), [(2, 0), (8, 8), (21, 21), (70, 70), (21, 5), (70, 0)]
)
def test_harmonics_agree_with_a_slow_recursion_poles_included(degree: int, order: int) -> None:
    rng = np.random.default_rng(degree)
    points = [*rng.normal(size=(8, 3)), [0, 0, 1], [0, 0, -1], [1e-9, 0, 1], [1, 0, 0], [0, -1, 0]]
    for point in points:
        fixed = np.array(point) / np.linalg.norm(point) * rng.uniform(6.6e6, 8e6)
        r = ROTATION.T @ fixed
        wide = ROTATION.astype(np.longdouble)
        slow = wide.T @ ref.harmonics(wide @ r, degree, order, JGM3.c, JGM3.s)
        fast = pull(ForceModel((degree, order)), r)
        assert np.linalg.norm((fast - slow).astype(float)) < 3e-15 * np.linalg.norm(fast)


def test_j2_and_j3_are_the_closed_forms() -> None:
    c = np.zeros(10)
    c[0], c[3], c[6] = 1.0, JGM3.c[3], JGM3.c[6]
    zonal = GravityField("zonal", ref.MU, ref.RE, 3, c, np.zeros(10))
    fixed = np.array([4e6, -3e6, 5e6])
    x, y, z = fixed
    r = np.linalg.norm(fixed)
    j3 = -np.sqrt(7.0) * c[6]
    five = 5 * j3 * ref.MU * ref.RE**3 / (2 * r**7) * (7 * z**3 / r**2 - 3 * z)
    third = [five * x, five * y, 0.0]
    third[2] = j3 * ref.MU * ref.RE**3 / (2 * r**5) * (35 * z**4 / r**4 - 30 * z**2 / r**2 + 3)
    k = 1.5 * zonal.j2 * (ref.RE / r) ** 2
    q = 5 * z**2 / r**2
    second = -ref.MU / r**3 * fixed * (1 + k * (np.array([1.0, 1.0, 3.0]) - q))
    made = ROTATION @ pull(ForceModel(3, field=zonal), ROTATION.T @ fixed)
    assert np.abs(made - (second + third)).max() < 1e-13 * ref.MU / r**2
    # the J2 model has the z axis of the GCRS
    assert np.abs(pull(ForceModel.j2(), fixed) - second).max() < 1e-11


def test_sun_and_moon_pull_as_point_masses_do() -> None:
    r = np.array([5e6, 4e6, -3e6])
    for body, mu in (("sun", 1.327124400412794e20), ("moon", 4.902800118457551e12)):
        made = pull(ForceModel("two-body", **{body: True}), r) - pull(ForceModel.two_body(), r)
        s = getattr(ref, body)(np.array([0.0]))[0]
        tide = mu * ((s - r) / np.linalg.norm(s - r) ** 3 - s / np.linalg.norm(s) ** 3)
        assert np.abs(made - tide).max() < 5e-15


def test_light_pushes_away_from_the_sun_and_not_in_the_shadow() -> None:
    s = ref.sun(np.array([0.0]))[0]
    model = ForceModel("two-body", srp=SolarPressure(cr=1.5, area_to_mass=0.01))
    for r, light in ((7e6 * s / np.linalg.norm(s), 1.0), (-7e6 * s / np.linalg.norm(s), 0.0)):
        made = pull(model, r) - pull(ForceModel.two_body(), r)
        away = r - s
        push = 4.56e-6 * 1.5 * 0.01 * ref.AU**2 * away / np.linalg.norm(away) ** 3
        assert np.abs(made - light * push).max() < 5e-15


def test_drag_is_half_rho_v_squared_against_the_turning_air() -> None:
    # over the pole the height is |z| - b, and the air stands still
    axis = ROTATION.T @ [0.0, 0.0, 1.0]
    height = 300e3
    r = (6356752.314245 + height) * axis
    v = ROTATION.T @ [7700.0, 0.0, 0.0]
    made = pull(ForceModel("two-body", drag=Drag(cd=2.0, area_to_mass=0.02)), r, v)
    made -= pull(ForceModel.two_body(), r, v)
    s = ref.sun(np.array([0.0]))[0]
    share = 0.5 * (1.0 + axis @ s / np.linalg.norm(s))
    rho = 1.708e-11 + (3.526e-11 - 1.708e-11) * share**3
    # ITRS and rotation axis differ by polar motion: 2e-6 rad
    assert made == pytest.approx(-0.5 * 2.0 * 0.02 * rho * 7700.0 * v, rel=1e-5, abs=1e-12)
    # a satellite that turns with the air feels none
    r = ROTATION.T @ [7e6, 0.0, 0.0]
    v = 7.292115146706979e-5 * np.cross(_axis(), r)
    made = pull(ForceModel("two-body", drag=Drag()), r, v) - pull(ForceModel.two_body(), r, v)
    assert np.abs(made).max() < 2e-15


def _axis() -> np.ndarray:
    x, y = ENV["cip"][6, :2]
    return np.array([x, y, np.sqrt(1 - x * x - y * y)])


def test_the_shipped_field_is_jgm3() -> None:
    assert (JGM3.mu, JGM3.radius, JGM3.degree) == (3.986004415e14, 6378136.3, 70)
    assert JGM3.j2 == pytest.approx(1.0826360e-3, rel=1e-7)
    assert JGM3.c[0] == 1.0
    assert len(JGM3.c) == 71 * 72 // 2
    assert np.count_nonzero(JGM3.c[3:]) == len(JGM3.c) - 3
    # Kaula's rule: about 1e-5 / n^2
    top = JGM3.c[70 * 71 // 2 :]
    assert 1e-10 < np.sqrt(np.mean(top**2)) < 1e-8


def test_a_gfc_file_is_read(tmp_path: Path) -> None:
    path = tmp_path / "small.gfc"
    head = "modelname small\nearth_gravity_constant 3.986d14\nradius 6.378E+06\nmax_degree 3\n"
    terms = "gfc 0 0 1 0\ngfct 2 0 -4.8D-4 0.0 0 0 20050101\ntrnd 2 0 1e-11 0 0 0\n"
    path.write_text(head + "end_of_head ====\n" + terms + "gfc 3 3 1e-7 -2e-7 0 0\n")
    field = GravityField.read(path)
    assert (field.name, field.mu, field.degree) == ("small", 3.986e14, 3)
    assert (field.c[3], field.c[9], field.s[9]) == (-4.8e-4, 1e-7, -2e-7)
    assert GravityField.read(path, degree=2).degree == 2
    with pytest.raises(InputError, match="from 0 to 3"):
        ForceModel(4, field=field)
    for text, what in ((head, "end_of_head"), ("radius 1\nend_of_head\n", "lacks earth_grav")):
        path.write_text(text)
        with pytest.raises(InputError, match=what):
            GravityField.read(path)
    path.write_text(head + "norm unnormalized\nend_of_head\n")
    with pytest.raises(InputError, match="fully normalised"):
        GravityField.read(path)
    with pytest.raises(InputError, match="cannot be read"):
        GravityField.read(tmp_path / "none.gfc")


def test_a_model_is_a_value() -> None:
    full = ForceModel.high_fidelity()
    assert full == ForceModel(21, True, True, SolarPressure(), Drag())
    assert replace(full, drag=None) != full
    assert len({full, ForceModel.high_fidelity()}) == 1
    assert ForceModel((8, 8)).gravity == 8
    assert cc.orbit.ForceModel is ForceModel


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: ForceModel("j3"), "'j2' or 'two-body'"),
        (lambda: ForceModel(71), "from 0 to 70"),
        (lambda: ForceModel((4, 5)), "order"),
        (lambda: ForceModel(2.5), "whole degree"),
        (lambda: ForceModel(srp=1.0), "srp"),
        (lambda: SolarPressure(cr=-1.0), "srp.cr"),
        (lambda: Drag(lag=30.0), "radians"),
        (lambda: Drag(exponent=1.0), "2 to 6"),
        (lambda: Drag(cd=np.nan), "drag.cd"),
        (lambda: ForceModel(8).acceleration([0.0], [[7e6, 0, 0]], [[0, 0, 0]]), "environment"),
    ],
)
def test_what_makes_no_model_is_refused(make: object, what: str) -> None:
    with pytest.raises(InputError, match=what):
        make()  # type: ignore[operator]
