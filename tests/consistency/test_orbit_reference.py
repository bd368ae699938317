"""Orbits over 600 min against satkit, drag and shadow against brahe (test extras)."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from celestcore.orbit import Drag, ForceModel, GravityField, SolarPressure, propagate

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "unit"))
erfa = pytest.importorskip("erfa")
import orbit_tables as ref  # noqa: E402

R0, V0 = ref.start()
END = 36_000.0
ARCSEC = np.pi / 648_000.0


@pytest.fixture(scope="module")
def sk(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return satkit with its data and, for Earth orientation, those of astropy."""
    satkit = pytest.importorskip("satkit")
    data = Path(pytest.importorskip("satkit_data").__file__).parent / "data"
    iers = Path(pytest.importorskip("astropy_iers_data").__file__).parent / "data"
    folder = tmp_path_factory.mktemp("satkit")
    for file in [*data.iterdir(), iers / "finals2000A.all"]:
        (folder / file.name).symlink_to(file)
    satkit.utils.set_datadir(str(folder))
    return satkit


@pytest.fixture(scope="module")
def tables(sk: Any) -> dict[str, Any]:
    """Tables with satkit's own Earth orientation and JPL ephemerides."""
    out = ref.tables(END)
    begin = sk.time(2007, 7, 1, 12, 0, 0.0)
    at = [begin + sk.duration(seconds=float(t)) for t in out["earth_t"]]
    eop = np.array([sk.frametransform.earth_orientation_params(x) for x in at])
    ut1 = eop[:, 0]
    now = int(np.flatnonzero(out["earth_t"] == 0.0)[0])
    out["ut1"] = np.array([ref.UTC[0], ref.UTC[1] + ut1[now] / 86_400.0])
    out["dut1"] = ut1 - ut1[now]
    out["pole"] = np.ascontiguousarray(eop[:, 1:3] * ARCSEC)
    out["cip"][:, :2] += eop[:, 4:6] * 1e-3 * ARCSEC
    at = [begin + sk.duration(seconds=float(t)) for t in out["body_t"]]
    for name in ("sun", "moon"):
        body = getattr(sk.solarsystem, name.capitalize())
        out[name] = np.array([sk.jplephem.geocentric_pos(body, x) for x in at])
    return out


def there(sk: Any, degree: int, bodies: bool, cram: float) -> np.ndarray:
    settings = sk.propsettings(
        gravity_degree=degree,
        gravity_model=sk.gravmodel.jgm3,
        use_sun_gravity=bodies,
        use_moon_gravity=bodies,
        use_relativistic_correction=False,
        tide_model=sk.tidemodel.none,
        use_spaceweather=False,
        abs_error=1e-12,
        rel_error=1e-13,
    )
    body = sk.satproperties(craoverm=cram, cdaoverm=0.0)
    begin = sk.time(2007, 7, 1, 12, 0, 0.0)
    made = sk.propagate(
        np.hstack([R0, V0]), begin, duration_secs=END, propsettings=settings, satproperties=body
    )
    return np.asarray(made.pos)


@pytest.mark.parametrize(
    ("degree", "bodies", "limit"), [(2, False, 1e-3), (21, False, 1e-3), (21, True, 5e-3)]
)
def test_gravity_agrees_with_satkit(
    sk: Any, tables: dict[str, Any], degree: int, bodies: bool, limit: float
) -> None:
    model = ForceModel(degree, sun=bodies, moon=bodies)
    out = propagate(model, ref.EPOCH, R0, V0, [0.0, END], environment=tables)
    distance = np.linalg.norm(out.r[-1] - there(sk, degree, bodies, 0.0))
    print(f"{degree}x{degree}, bodies {bodies}: {distance * 1e3:.3f} mm after 600 min")
    assert distance < limit


def test_radiation_pressure_agrees_with_satkit(sk: Any, tables: dict[str, Any]) -> None:
    model = ForceModel(21, sun=True, moon=True, srp=SolarPressure(cr=1.0, area_to_mass=0.02))
    out = propagate(model, ref.EPOCH, R0, V0, [0.0, END], environment=tables)
    plain = propagate(
        ForceModel(21, sun=True, moon=True), ref.EPOCH, R0, V0, [0.0, END], environment=tables
    )
    distance = np.linalg.norm(out.r[-1] - there(sk, 21, True, 0.02))
    moved = np.linalg.norm(out.r[-1] - plain.r[-1])
    print(f"with radiation pressure: {distance * 1e3:.3f} mm of {moved:.2f} m")
    assert distance < 5e-3


@pytest.fixture(scope="module")
def bh() -> Any:
    return pytest.importorskip("brahe")


def axis_frame() -> np.ndarray:
    """Return GCRS to the frame of the pole and the intermediate origin, at the epoch."""
    out: np.ndarray = erfa.c2ixys(*erfa.xys06a(*ref.TT))
    return out


def brahe_drag(bh: Any, x: np.ndarray, sun: np.ndarray, frame: np.ndarray) -> np.ndarray:
    density = bh.density_harris_priester(frame @ x[:3], frame @ sun)
    return np.asarray(bh.accel_drag(x, density, 100.0, 2.0, 2.0, frame))


def test_drag_agrees_with_brahe(bh: Any) -> None:
    env = ref.tables()
    frame, sun = axis_frame(), ref.sun(np.array([0.0]))[0]
    rng = np.random.default_rng(5)
    with_drag, without = ForceModel("two-body", drag=Drag()), ForceModel.two_body()
    for height in rng.uniform(120e3, 990e3, 60):
        r = rng.normal(size=3)
        r *= (6.3781e6 + height) / np.linalg.norm(r)
        v = 7500.0 * np.cross(r, rng.normal(size=3)) / np.linalg.norm(r)
        state = ([0.0], [r], [v])
        made = with_drag.acceleration(*state, environment=env)[0]
        made -= without.acceleration(*state)[0]
        there = brahe_drag(bh, np.hstack([r, v]), sun, frame)
        # polar motion (2e-6 rad) moves the height by 0.05 m
        assert np.linalg.norm(made - there) < 1e-5 * np.linalg.norm(there) + 4e-15


def test_the_shadow_agrees_with_brahe(bh: Any) -> None:
    env = ref.tables()
    sun = ref.sun(np.array([0.0]))[0]
    pushed, plain = ForceModel("two-body", srp=SolarPressure()), ForceModel.two_body()
    toward = sun / np.linalg.norm(sun)
    side = np.cross(toward, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    partial = 0
    for across in np.linspace(6.30e6, 6.46e6, 81):
        r = -3e6 * toward + across * side
        state = ([0.0], [r], [[0.0, 0.0, 0.0]])
        made = pushed.acceleration(*state, environment=env)[0] - plain.acceleration(*state)[0]
        full = 4.56e-6 * 0.02 * ref.AU**2 / np.linalg.norm(r - sun) ** 2
        light = bh.eclipse_conical(r, sun)
        partial += 0.0 < light < 1.0
        # the radii of Sun and Earth differ by some 1e-4
        assert abs(np.linalg.norm(made) / full - light) < 2e-2
    assert partial > 5


def test_an_orbit_with_drag_agrees_with_brahe_and_scipy(bh: Any) -> None:
    solve_ivp = pytest.importorskip("scipy.integrate").solve_ivp
    env = ref.tables()
    frame, sun = axis_frame(), ref.sun(np.array([0.0, END]))
    mu, radius, j2 = ref.MU, ref.RE, GravityField.jgm3().j2

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        r2 = x[:3] @ x[:3]
        k = 1.5 * j2 * radius**2 / r2
        q = 5.0 * x[2] ** 2 / r2
        gravity = -mu * r2**-1.5 * x[:3] * (1.0 + k * (np.array([1.0, 1.0, 3.0]) - q))
        now = sun[0] + (sun[1] - sun[0]) * (t / END)
        return np.hstack([x[3:], gravity + brahe_drag(bh, x, now, frame)])

    there = solve_ivp(
        slope, (0.0, END), np.hstack([R0, V0]), method="DOP853", rtol=1e-12, atol=1e-6
    )
    model = ForceModel("j2", drag=Drag(cd=2.0, area_to_mass=0.02))
    out = propagate(model, ref.EPOCH, R0, V0, [0.0, END], environment=env)
    plain = propagate(ForceModel.j2(), ref.EPOCH, R0, V0, [0.0, END])
    distance = np.linalg.norm(out.r[-1] - there.y[:3, -1])
    moved = np.linalg.norm(out.r[-1] - plain.r[-1])
    print(f"with drag: {distance * 1e3:.2f} mm of {moved:.1f} m")
    assert moved > 10.0
    assert distance < 0.1
