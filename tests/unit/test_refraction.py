"""Starlight refraction against rays of their own, and which stars are refracted when."""

from __future__ import annotations

import itertools
import pickle
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore._check import FloatArray
from celestcore.celestial import Atmosphere, RefractedStars, refracted_stars
from rays import density, grazing
from scipy.integrate import quad

ARCSEC = cc.ARCSEC


def test_the_standard_atmosphere_is_a_second_one_of_its_own() -> None:
    height = np.arange(0.0, 120e3, 777.0)
    own = np.array([density(h)[0] for h in height])
    np.testing.assert_allclose(Atmosphere().density(height), own, rtol=2e-5)


@pytest.mark.parametrize("height", [20e3, 25e3, 30e3, 35e3, 40e3, 50e3, 70e3, 90e3])
def test_bending_is_its_integral(height: float) -> None:
    """Bouguer's integral over the angle from the lowest point: another variable than the core's."""
    lowest = 6378137.0 + height
    b = (1.0 + 2.26e-4 * density(height)[0]) * lowest

    def over(angle: float) -> float:
        r = lowest / np.cos(angle)
        rho, slope = density(r - 6378137.0)
        n = 1.0 + 2.26e-4 * rho
        # n^2 r^2 - b^2 without cancellation: in the height above the lowest point
        rise = lowest * 2.0 * np.sin(angle / 2) ** 2 / np.cos(angle)
        more = n * rise + 2.26e-4 * (rho - density(height)[0]) * lowest
        dr = lowest * np.sin(angle) / np.cos(angle) ** 2
        return float(-2.26e-4 * slope / n * b / np.sqrt(more * (n * r + b)) * dr)

    marks = [11019.0, 20063.0, 32162.0, 47350.0, 51413.0, 71802.0, 86e3, 200e3]
    ends = [0.0, *(np.arccos(lowest / (6378137.0 + m)) for m in marks if m > height)]
    parts = [
        quad(over, a, e, epsabs=1e-16, epsrel=1e-11, limit=200)[0]
        for a, e in itertools.pairwise(ends)
    ]
    assert Atmosphere().bending(height) == pytest.approx(2.0 * sum(parts), rel=3e-5)


@pytest.mark.parametrize("height", [21e3, 25e3, 30e3, 40e3])
def test_rays_over_a_sphere_are_those_of_the_differential_equation(height: float) -> None:
    for scale in (1.0, 1.03):
        r, star, bent = grazing(height, 0.3, 1.1, flattening=0.0, scale=scale)
        rays = cc.StarRefraction(oblate=False).rays(r, star, scale=scale)
        # air that is 3 % denser bends by 3 % more to a part in ten thousand
        tolerance = 4e-5 if scale == 1.0 else 2e-4
        assert rays.angle == pytest.approx(bent, rel=tolerance)
        assert rays.height == pytest.approx(height, abs=1.0 if scale == 1.0 else 3.0)


@pytest.mark.parametrize("latitude", [-80.0, -45.0, 0.0, 30.0, 45.0, 65.0, 89.0])
def test_rays_over_the_ellipsoid(latitude: float) -> None:
    """The osculating sphere is right to 0.5 m, where the equator's is off by up to 21 km."""
    worst = 0.0
    for azimuth in (0.0, 50.0, 90.0, 200.0, 300.0):
        for height in (21e3, 30e3):
            r, star, bent = grazing(height, latitude * cc.DEG, azimuth * cc.DEG)
            rays = cc.StarRefraction().rays(r, star)
            slope = np.linalg.norm(rays.by_position)
            off = (abs(rays.angle - bent) / slope, abs(rays.height - height))
            worst = max(worst, *map(float, off))
    assert worst < 0.5


def test_angles_have_the_derivatives_they_say() -> None:
    r, star, _ = grazing(28e3, 0.5, 0.8)
    sensor = cc.StarRefraction()
    rays = sensor.rays(r, star)
    step = 5.0 * np.eye(3)
    by = (sensor.rays(r + step, star).angle - sensor.rays(r - step, star).angle) / 10.0
    np.testing.assert_allclose(rays.by_position, by, atol=1e-5 * np.abs(by).max())
    denser = [sensor.rays(r, star, scale=s).angle for s in (0.999, 1.001)]
    assert rays.by_density == pytest.approx((denser[1] - denser[0]) / 2e-3, rel=1e-5)


def test_the_pole_is_the_date_s() -> None:
    """Precession moves the pole by 150 arcsec until 2007: metres of height at middle latitudes."""
    r, star, _ = grazing(28e3, 0.8, 0.1)
    sensor = cc.StarRefraction()
    now, then = (sensor.rays(r, star, epoch=e).height for e in (None, "2007-07-01T12:00:00"))
    assert 0.1 < abs(now - then) < 20.0
    ball = cc.StarRefraction(oblate=False)
    assert ball.rays(r, star).height == ball.rays(r, star, epoch="2007-07-01T12:00:00").height


def orbit(n: int = 400, period: float = 15.0) -> cc.orbit.Trajectory:
    t = period * np.arange(n)
    start = cc.elements.Elements(7136.635e3, 1.809e-3, 65 * cc.DEG, 0.5, 0.5, 0.0)
    r0, v0 = cc.elements.to_state(start)
    return cc.orbit.propagate(cc.orbit.ForceModel.j2(), None, r0, v0, t)


@pytest.fixture(scope="module")
def sky() -> cc.StarCatalogue:
    return cc.StarCatalogue.hipparcos(epoch=2007.5, magnitude=6.0)


@pytest.fixture(scope="module")
def flight() -> cc.orbit.Trajectory:
    return orbit()


@pytest.fixture(scope="module")
def seen(flight: cc.orbit.Trajectory, sky: cc.StarCatalogue) -> RefractedStars:
    return refracted_stars(flight, sky)


def test_refracted_stars_are_those_with_rays_in_the_band(
    flight: cc.orbit.Trajectory, sky: cc.StarCatalogue, seen: RefractedStars
) -> None:
    for k in range(0, len(flight), 37):
        rays = seen.sensor.rays(flight.r[k], sky.directions)
        there = np.flatnonzero((rays.height >= 20e3) & (rays.height <= 50e3) & (rays.angle > 0.0))
        mine = seen.epoch == k
        assert sorted(seen.row[mine]) == there.tolist()
        assert seen.counts[k] == len(there)
        np.testing.assert_array_equal(seen.angle[mine], rays.angle[seen.row[mine]])
    assert (np.diff(seen.epoch) >= 0).all()
    np.testing.assert_array_equal(seen.t, flight.t[seen.epoch])


def test_fields_see_what_lies_in_them(
    flight: cc.orbit.Trajectory, sky: cc.StarCatalogue, seen: RefractedStars
) -> None:
    q = cc.frames.orbital(flight.r, flight.v)
    o = cc.quaternion.rotate(cc.quaternion.conjugate(q[seen.epoch]), seen.star)
    half = 5 * cc.DEG
    for name, azimuth in (("fore", 0.0), ("right", 90.0), ("aft", 180.0), ("left", -90.0)):
        field = refracted_stars(flight, sky, fields=[name])
        off = np.angle(np.exp(1j * (np.arctan2(o[:, 1], o[:, 0]) - azimuth * cc.DEG)))
        # along the limb a field of 10 degrees is wider in azimuth, by the limb's depression of 26
        inside = np.abs(off) < half / np.cos(26.5 * cc.DEG)
        both = np.isin(seen.place, field.place)
        assert (both == inside).mean() > 0.998
        assert 0.01 < len(field) / len(seen) < 0.1
    turned = refracted_stars(flight, sky, fields=[np.pi])
    np.testing.assert_array_equal(turned.place, refracted_stars(flight, sky, fields=["aft"]).place)


def test_passes_are_of_one_star_without_a_gap(seen: RefractedStars) -> None:
    for number in np.unique(seen.occultation):
        mine = seen.occultation == number
        assert len(set(seen.row[mine])) == 1
        assert (np.diff(seen.epoch[mine]) == 1).all()
    starts = [seen.epoch[seen.occultation == n][0] for n in np.unique(seen.occultation)]
    assert (np.diff(starts) >= 0).all()


def test_a_pass_has_air_of_one_density(flight: cc.orbit.Trajectory, sky: cc.StarCatalogue) -> None:
    sensor = cc.StarRefraction(1e-15, density_sigma=0.01)
    seen = refracted_stars(flight, sky, sensor)
    t, star, angle = seen.measured(seed=3)
    np.testing.assert_array_equal(t, seen.t)
    np.testing.assert_array_equal(star, seen.star)
    by = sensor.rays(seen.r, seen.star).by_density
    error = (angle - seen.angle) / by
    mean = np.bincount(seen.occultation, error) / np.bincount(seen.occultation)
    # the derivative is the whole of it to first order
    assert np.abs(error - mean[seen.occultation]).max() < 1e-3
    n = len(mean)
    assert abs(mean.mean()) < 4 * 0.01 / np.sqrt(n)
    assert mean.std() == pytest.approx(0.01, rel=4 / np.sqrt(2 * n))
    biased = seen.measured(seed=3, density_bias=0.01)[2]
    np.testing.assert_allclose((biased - angle) / by, 0.01, rtol=0.05)


def test_each_angle_has_an_error_of_its_own(seen: RefractedStars) -> None:
    sensor = cc.StarRefraction(3 * ARCSEC, density_sigma=0.0)
    own = RefractedStars(**{**vars(seen), "sensor": sensor})
    error = (own.measured(seed=5)[2] - seen.angle) / sensor.sigma
    n = len(error)
    assert abs(error.mean()) < 4 / np.sqrt(n)
    assert error.std() == pytest.approx(1.0, abs=4 / np.sqrt(2 * n))
    assert abs(np.mean(error[1:] * error[:-1])) < 4 / np.sqrt(n)


def test_errors_belong_to_seed_trial_and_sight(
    flight: cc.orbit.Trajectory, sky: cc.StarCatalogue, seen: RefractedStars
) -> None:
    once = seen.measured(seed=1, trial=2)[2]
    np.testing.assert_array_equal(once, seen.measured(seed=1, trial=2)[2])
    assert (once != seen.measured(seed=1, trial=3)[2]).all()
    assert (once != seen.measured(seed=2, trial=2)[2]).all()
    aft = refracted_stars(flight, sky, fields=["aft"])
    np.testing.assert_array_equal(aft.measured(seed=1, trial=2)[2], once[aft.place])


def fixed(
    r: FloatArray, sensor: cc.StarRefraction, star: FloatArray, angle: FloatArray
) -> FloatArray:
    """Return the position that refractions all around give, by Gauss and Newton."""
    for _ in range(8):
        rays = sensor.rays(r, star)
        r = r + np.linalg.lstsq(rays.by_position, angle - rays.angle, rcond=None)[0]
    return r


def test_refractions_all_around_fix_a_position(
    flight: cc.orbit.Trajectory, seen: RefractedStars
) -> None:
    rng = np.random.default_rng(1)
    squares, numbers = 0.0, 0
    for k in range(0, len(flight), 8):
        mine = seen.epoch == k
        star, angle = seen.star[mine], seen.angle[mine]
        start = flight.r[k] + 300.0 * rng.normal(size=3)
        found = fixed(start, seen.sensor, star, angle)
        assert np.linalg.norm(found - flight.r[k]) < 0.01
        noisy = fixed(start, seen.sensor, star, angle + 1e-7 * rng.normal(size=len(angle)))
        h = seen.sensor.rays(flight.r[k], star).by_position / 1e-7
        error = h @ (noisy - flight.r[k])
        squares, numbers = squares + error @ error, numbers + 3
    assert abs(squares - numbers) < 4 * np.sqrt(2 * numbers)


def test_a_table_of_the_standard_is_the_standard() -> None:
    height = np.arange(0.0, 86e3, 500.0)
    air = Atmosphere(height, Atmosphere().density(height))
    test = np.array([14e3, 18e3, 22e3, 25e3, 28e3, 30e3, 35e3, 40e3, 45e3, 55e3, 65e3])
    np.testing.assert_allclose(air.bending(test), Atmosphere().bending(test), rtol=1e-4)
    np.testing.assert_allclose(air.height(air.bending(test)), test, atol=1e-5)
    again = pickle.loads(pickle.dumps(air))
    assert again == air
    assert hash(again) == hash(air)
    assert again != Atmosphere()
    assert pickle.loads(pickle.dumps(Atmosphere())) == Atmosphere()


R = [7.138e6, 0.0, 0.0]


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: cc.StarRefraction(-1.0), "sigma"),
        (lambda: cc.StarRefraction(3.0), "sigma"),
        (lambda: cc.StarRefraction(density_sigma=1.0), "density_sigma"),
        (lambda: cc.StarRefraction(band=(50e3, 20e3)), "band"),
        (lambda: cc.StarRefraction(band=(20e3, np.nan)), "band"),
        (lambda: cc.StarRefraction(atmosphere="standard"), "atmosphere"),  # type: ignore[arg-type]
        (lambda: cc.StarRefraction().rays([7138.0, 0, 0], [1.0, 0, 0]), "r"),
        (lambda: cc.StarRefraction().rays(R, [2.0, 0, 0]), "star"),
        (lambda: cc.StarRefraction().rays(R, [np.nan, 0, 0]), "star"),
        (lambda: cc.StarRefraction().rays(R, [1.0, 0]), "star"),
        (lambda: cc.StarRefraction().rays([R] * 2, [[1.0, 0, 0]] * 3), "star"),
        (lambda: cc.StarRefraction().rays(R, [1.0, 0, 0], scale=0.0), "scale"),
        (lambda: Atmosphere([0.0, 1e4, 2e4]), "density"),
        (lambda: Atmosphere([0.0, 10.0, 20.0], [1.2, 1.3, 1.1]), "density"),
        (lambda: Atmosphere([0.0, 1e4, 5e3], [1.2, 0.4, 0.1]), "height"),
    ],
)
def test_bad_input_is_named(call: Any, field: str) -> None:
    with pytest.raises(cc.errors.InputError) as caught:
        call()
    assert caught.value.field == field


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"fields": "aft"}, "fields"),
        ({"fields": []}, "fields"),
        ({"fields": ["down"]}, "fields"),
        ({"field_of_view": (0.0, 1.0)}, "field_of_view"),
    ],
)
def test_bad_fields_are_named(
    options: dict[str, Any], field: str, flight: cc.orbit.Trajectory, sky: cc.StarCatalogue
) -> None:
    with pytest.raises(cc.errors.InputError) as caught:
        refracted_stars(flight, sky, **options)
    assert caught.value.field == field


def test_a_flight_through_the_night_is_quick(sky: cc.StarCatalogue) -> None:
    seen = refracted_stars(orbit(2401), sky, fields=["aft", "right"])
    assert (seen.counts == 0).any()
    with pytest.raises(cc.errors.InputError):
        seen.measured(density_bias=2.0)
    with pytest.raises(cc.errors.InputError):
        seen.measured(trial=-1)


def test_a_navigator_runs_on_refractions(sky: cc.StarCatalogue) -> None:
    """Kilometres at the start become tens of metres, and innovations are what they should be."""
    flight = orbit(600)
    sensor = cc.StarRefraction()
    seen = refracted_stars(flight, sky, sensor, fields=["fore", "aft", "right", "left"])
    log = cc.CelestialLog(refraction=seen.measured(seed=4))
    dynamics = cc.orbit.OrbitDynamics(cc.orbit.ForceModel.j2(), accel_psd=1e-9)
    rng = np.random.default_rng(4)
    r0 = flight.r[0] + 1e3 * rng.normal(size=3)
    v0 = flight.v[0] + rng.normal(size=3)
    for chosen in (cc.EKF(), cc.UKF()):
        nav = cc.CelestialNavigator(chosen, dynamics, sensor)
        sol = nav.run(log, r0, v0, t0=0.0, t_output=flight.t[1:])
        off = np.linalg.norm(sol.r - flight.r, axis=1)[300:]
        assert off.mean() < 100.0
        assert np.nanmean(sol.nis) == pytest.approx(1.0, abs=4 * np.sqrt(2 / len(seen)))
        ball = cc.CelestialNavigator(chosen, dynamics, cc.StarRefraction(oblate=False))
        wrong = ball.run(log, r0, v0, t0=0.0, t_output=flight.t[1:])
        assert np.linalg.norm(wrong.r - flight.r, axis=1)[300:].mean() > 1e3
