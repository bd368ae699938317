"""Starts that cannot be: no majority, too few fixes, wrong units."""

from __future__ import annotations

from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import orbit
from celestcore.gnss.start import orbit_start

T = 10.0 * np.arange(8)
ORBIT = orbit.propagate(orbit.ForceModel.j2(), None, [7e6, 0, 0], [0, 4e3, 6.4e3], T)
RNG = np.random.default_rng(1)
R = ORBIT.r + RNG.standard_normal((8, 3))
V = ORBIT.v + 0.01 * RNG.standard_normal((8, 3))


@pytest.mark.parametrize("v", [None, V])
def test_no_majority(v: Any) -> None:
    r = R.copy()
    r[:4] += 1e4 * np.random.default_rng(2).standard_normal((4, 3))
    with pytest.raises(cc.InputError, match=r"r_i: no orbit.*at most 4 of 8 fixes.*majority"):
        orbit_start(T, r, v)
    wild = R + 1e6 * np.random.default_rng(2).standard_normal((8, 3))
    with pytest.raises(cc.InputError, match=r"at most [0-3] of 8 fixes.*sigma 1 m"):
        orbit_start(T, wild, v)


def test_two_of_three_positions_prove_nothing() -> None:
    r = R[:3].copy()
    r[1] += 500.0
    with pytest.raises(cc.InputError, match="at most 2 of 3"):
        orbit_start(T[:3], r)


def test_too_small_a_sigma_is_said() -> None:
    v = V + 2.0 * np.random.default_rng(4).standard_normal((8, 3))
    with pytest.raises(cc.InputError, match=r"sigma_velocity 0\.1 m/s"):
        orbit_start(T, R, v)
    assert orbit_start(T, R, v, sigma_velocity=2.0).good.all()


def nan(a: Any) -> Any:
    out = a.copy()
    out[2, 1] = np.nan
    return out


BAD: dict[str, tuple[tuple[Any, ...], dict[str, Any], str]] = {
    "one position": ((T[:1], R[:1]), {}, "two fixes at least"),
    "kilometres": ((T, R * 1e-3), {}, "kilometres"),
    "lengths": ((T, R[:5]), {}, "r_i: has 5 rows but t has 8"),
    "nan": ((T, nan(R)), {}, "r_i, row 2.*finite"),
    "nan velocity": ((T, R, nan(V)), {}, "v_i, row 2.*finite"),
    "time goes back": ((T[::-1], R), {}, "t, row 1.*goes back"),
    "sigma": ((T, R), {"sigma": 0.0}, "sigma.*greater than 0"),
    "sigma of velocity": ((T, R, V), {"sigma_velocity": -1.0}, "sigma_velocity.*greater"),
    "fixes": ((T, R), {"fixes": 0}, "fixes.*at least 1"),
    "force": ((T, R), {"force": "j2"}, "force.*ForceModel"),
    "no tables": ((T, R), {"force": orbit.ForceModel(gravity=4)}, "tables.*environment"),
    "slack": ((T, R), {"accel_sigma": -1.0}, "accel_sigma"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_input(name: str) -> None:
    args, options, match = BAD[name]
    with pytest.raises(cc.InputError, match=match):
        orbit_start(*args, **options)
