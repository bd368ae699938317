"""The shipped EGM2008: its numbers, what it was cut from, and how far it is from JGM-3."""

from __future__ import annotations

import hashlib
from importlib import import_module
from importlib.resources import files

import numpy as np
import orbit_tables as ref
import pytest
from celestcore import InputError
from celestcore.orbit import ForceModel, GravityField

EGM2008 = GravityField.egm2008()
JGM3 = GravityField.jgm3()


def at(n: int, m: int) -> int:
    return n * (n + 1) // 2 + m


def test_constants_and_some_coefficients_as_published() -> None:
    assert (EGM2008.mu, EGM2008.radius, EGM2008.degree) == (3.986004415e14, 6378136.3, 70)
    assert (EGM2008.name, EGM2008.tide_system) == ("EGM2008", "tide_free")
    assert EGM2008.c[at(2, 0)] == -0.484165143790815e-03
    assert EGM2008.c[at(2, 2)] == 0.243938357328313e-05
    assert EGM2008.s[at(2, 2)] == -0.140027370385934e-05
    assert EGM2008.c[at(3, 0)] == 0.957161207093473e-06
    assert (EGM2008.c[0], EGM2008.c[1], EGM2008.c[2], EGM2008.s[1]) == (1.0, 0.0, 0.0, 0.0)
    assert np.count_nonzero(EGM2008.c[3:]) == len(EGM2008.c) - 3


def test_the_file_is_the_one_the_note_tells_of() -> None:
    data = files("celestcore") / "data"
    digest = hashlib.sha256((data / "EGM2008.gfc").read_bytes()).hexdigest()
    assert digest in (data / "README.md").read_text(encoding="utf-8")


def test_c20_differs_from_jgm3_by_the_permanent_tide_and_little_else() -> None:
    apart = EGM2008.c[at(2, 0)] - JGM3.c[at(2, 0)]
    tide = 4.1736e-9  # 3.1108e-8 * 0.4472 * 0.3, IERS Conventions (2010) eq. 6.14
    assert abs(apart - tide) < 3e-10
    # per degree the fields differ by less than themselves: they are the same Earth
    for n in range(3, 40):
        rows = slice(at(n, 0), at(n, n) + 1)
        own = np.hypot(EGM2008.c[rows], EGM2008.s[rows])
        other = np.hypot(EGM2008.c[rows] - JGM3.c[rows], EGM2008.s[rows] - JGM3.s[rows])
        assert np.sqrt(np.mean(other**2)) < 0.5 * np.sqrt(np.mean(own**2))


@pytest.mark.parametrize("degree", [20, 70])
def test_it_pulls_nearly_as_jgm3_does(degree: int) -> None:
    rng = np.random.default_rng(1)
    way = rng.standard_normal((40, 3))
    r = 6.884e6 * way / np.linalg.norm(way, axis=1, keepdims=True)
    env = ref.tables()
    field = GravityField.egm2008(degree=degree)
    pulls = [
        ForceModel(degree, field=f).acceleration(np.zeros(40), r, 0.0 * r, environment=env)
        for f in (field, JGM3)
    ]
    off = np.sqrt(np.mean(np.sum((pulls[0] - pulls[1]) ** 2, axis=1)))
    assert 5e-7 < off < 5e-6  # of 8.4


def test_it_is_read_once_and_cut_where_asked() -> None:
    assert GravityField.egm2008(20) is GravityField.egm2008(degree=20)
    assert GravityField.egm2008(200) is EGM2008
    assert np.array_equal(GravityField.egm2008(20).c, EGM2008.c[: at(21, 0)])
    with pytest.raises(InputError, match="at least 0"):
        GravityField.egm2008(-1)


def test_brahe_has_the_same_field() -> None:
    brahe = import_module("brahe") if _has("brahe") else pytest.skip("brahe is not installed")
    model = brahe.GravityModel.from_model_type(brahe.GravityModelType.EGM2008_120)
    assert model.gm == pytest.approx(EGM2008.mu, rel=1e-15)
    for n, m in ((2, 0), (5, 3), (21, 20), (70, 70)):
        c, s = model.get(n, m)
        assert (c, s) == (EGM2008.c[at(n, m)], EGM2008.s[at(n, m)])


def _has(name: str) -> bool:
    try:
        import_module(name)
    except ImportError:
        return False
    return True
