"""Settings of GNSS and star logs: every key, and the navigator they describe."""

from __future__ import annotations

from typing import Any

import celestcore as cc
import pytest
from celestcore.config import Settings
from celestcore.errors import InputError
from celestcore.gnss import GaussMarkov, GnssReceiver, KinematicAttitude, LowFrequencyError
from celestcore.orbit import Drag, ForceModel, GravityField, OrbitDynamics, SolarPressure
from celestcore.sensors import Gyro, StarCamera
from celestcore.units import ARCSEC


def navigator(gyro: bool = False, **tables: dict[str, Any]) -> cc.GnssStarNavigator:
    tables["gnss"] = {"sigma": 1.0, **tables.get("gnss", {})}
    return Settings.from_dict(tables).gnss_navigator(gyro=gyro)


def test_what_is_not_said() -> None:
    nav = navigator()
    assert nav.gnss == GnssReceiver(1.0, None)
    assert nav.dynamics == OrbitDynamics(ForceModel(gravity=20), 1e-8)
    assert nav.attitude == KinematicAttitude()
    assert (nav.filter.kind, nav.gate, nav.max_rejected) == ("ekf", 0.9999, 10)
    assert (nav.gyro, nav.lfe, nav.star_time_offset) == (None, None, 0.0)
    assert nav.star == StarCamera()


@pytest.mark.parametrize(
    ("key", "value", "wanted"),
    [
        ("sigma", [1.0, 2.0, 3.0], GnssReceiver((1.0, 2.0, 3.0), None)),
        ("sigma_velocity", 0.1, GnssReceiver(1.0, 0.1)),
        ("sigma_velocity", [0.1, 0.2, 0.3], GnssReceiver(1.0, (0.1, 0.2, 0.3))),
        ("lever_arm", [0.2, 0.0, 1], GnssReceiver(1.0, None, lever_arm=(0.2, 0.0, 1.0))),
        ("time_offset", -0.1, GnssReceiver(1.0, None, time_offset=-0.1)),
    ],
)
def test_keys_of_the_receiver(key: str, value: Any, wanted: GnssReceiver) -> None:
    assert navigator(gnss={key: value}).gnss == wanted


def test_the_receivers_bias() -> None:
    bias = {"bias_sigma": 2.0, "bias_tau": 600}
    assert navigator(gnss=bias).gnss.bias == GaussMarkov(2.0, 600.0)
    own = Settings.from_dict({"gnss": {"sigma": 1.0, **bias}})
    assert own.merged({"gnss": {"bias_sigma": 0}}).gnss_navigator().gnss.bias is None


def test_max_rejected() -> None:
    assert navigator(gnss={"max_rejected": 5}).max_rejected == 5
    assert navigator(gnss={"max_rejected": 0}).max_rejected is None


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ({"gravity": 8}, ForceModel(gravity=8)),
        ({"gravity": [8, 4]}, ForceModel(gravity=(8, 4))),
        ({"gravity": "j2"}, ForceModel(gravity="j2")),
        ({"field": "EGM2008"}, ForceModel(gravity=20, field=GravityField.egm2008())),
        ({"sun": True, "moon": True}, ForceModel(gravity=20, sun=True, moon=True)),
        ({"drag_area_to_mass": 0.01}, ForceModel(gravity=20, drag=Drag(area_to_mass=0.01))),
        (
            {"drag_area_to_mass": 0.01, "drag_cd": 2.2},
            ForceModel(gravity=20, drag=Drag(2.2, 0.01)),
        ),
        (
            {"srp_area_to_mass": 0.01, "srp_cr": 1.3},
            ForceModel(gravity=20, srp=SolarPressure(1.3, 0.01)),
        ),
    ],
)
def test_keys_of_the_forces(values: dict[str, Any], wanted: ForceModel) -> None:
    assert repr(navigator(orbit=values).dynamics.force) == repr(wanted)


def test_keys_of_the_dynamics() -> None:
    found = navigator(orbit={"accel_psd": 3e-7, "max_step": 10}).dynamics
    assert (found.accel_psd, found.max_step) == (3e-7, 10.0)


def test_keys_of_the_attitude() -> None:
    values = {"jerk_psd": 1e-13, "rate_sigma": 1e-3, "acceleration_sigma": 1e-5}
    assert navigator(attitude=values).attitude == KinematicAttitude(1e-13, 1e-3, 1e-5)


def test_keys_of_the_slow_error() -> None:
    fading = {"fading_sigma_arcsec": 2, "fading_tau": 600}
    found = navigator(lfe={"amplitudes_arcsec": [10, 3], "period": 6000, **fading}).lfe
    assert found == LowFrequencyError(
        (10 * ARCSEC, 3 * ARCSEC), 6000.0, GaussMarkov(2 * ARCSEC, 600.0)
    )
    assert navigator(lfe=fading).lfe.harmonics == 0


def test_time_offset_of_the_stars() -> None:
    two = {"star_1": {"sigma": 1e-5, "time_offset": 0.1}, "star_2": {"sigma": 1e-5}}
    assert navigator(star={"sigma": 1e-5, "time_offset": 0.1}).star_time_offset == 0.1
    with pytest.raises(InputError, match=r"star_1\.time_offset, .*must be the same"):
        navigator(**two)
    two["star_2"]["time_offset"] = 0.1
    assert navigator(**two).star_time_offset == 0.1
    alone = Settings.from_dict({"gyro": {"arw": 1e-6}, "star": {"time_offset": 0.1}})
    with pytest.raises(InputError, match="shift the times of the log"):
        alone.navigator()


def test_a_gyro_counts_if_it_is_there_and_described() -> None:
    settings = Settings.from_dict({"gnss": {"sigma": 1.0}, "gyro": {"arw": 1e-6}})
    assert settings.gnss_navigator(gyro=True).gyro == Gyro(1e-6)
    assert settings.gnss_navigator().gyro is None
    assert Settings.from_dict({"gnss": {"sigma": 1.0}}).gnss_navigator(gyro=True).gyro is None


def test_gate_and_filter() -> None:
    nav = navigator(gate={"probability": 0.99}, filter={"kind": "ukf", "alpha": 0.5})
    assert (nav.gate, nav.filter.kind, nav.filter.alpha) == (0.99, "ukf", 0.5)


BAD: dict[str, tuple[dict[str, Any], str, str]] = {
    "negative": ({"gnss": {"sigma": -1}}, "gnss.sigma", "positive"),
    "velocity": ({"gnss": {"sigma_velocity": 0}}, "gnss.sigma_velocity", "positive"),
    "arm": ({"gnss": {"lever_arm": [1.0]}}, "gnss.lever_arm", "shape"),
    "far arm": ({"gnss": {"lever_arm": [0, 0, 2000]}}, "gnss.lever_arm", "metres"),
    "half a bias": ({"gnss": {"bias_sigma": 1}}, "gnss.bias_sigma", "both"),
    "bias": ({"gnss": {"bias_sigma": 1, "bias_tau": 0}}, "gnss.bias_tau", "greater than 0"),
    "rejected": ({"gnss": {"max_rejected": 1.5}}, "gnss.max_rejected", "whole"),
    "key": ({"gnss": {"sigma_m": 1}}, "gnss.sigma_m", "known are sigma, sigma_velocity"),
    "gravity": ({"orbit": {"gravity": "jgm"}}, "orbit.gravity", "two-body"),
    "gravity type": ({"orbit": {"gravity": True}}, "orbit.gravity", "a degree"),
    "degree": ({"orbit": {"gravity": 900}}, "orbit.gravity", "from 0 to"),
    "field": ({"orbit": {"field": "EGM96"}}, "orbit.field", "JGM-3, EGM2008"),
    "sun": ({"orbit": {"sun": 1}}, "orbit.sun", "true or false"),
    "cd alone": ({"orbit": {"drag_cd": 2}}, "orbit.drag_cd", "drag_area_to_mass"),
    "cr": (
        {"orbit": {"srp_area_to_mass": 0.1, "srp_cr": -1}},
        "orbit.srp_cr",
        "at least 0",
    ),
    "psd": ({"orbit": {"accel_psd": -1e-8}}, "orbit.accel_psd", "at least 0"),
    "step": ({"orbit": {"max_step": 0}}, "orbit.max_step", "greater than 0"),
    "jerk": ({"attitude": {"jerk_psd": 0}}, "attitude.jerk_psd", "greater than 0"),
    "harmonics": ({"lfe": {"amplitudes": [1e-5] * 3}}, "lfe.amplitudes", "2 harmonics"),
    "no list": ({"lfe": {"amplitudes": 1e-5}}, "lfe.amplitudes", "a list"),
    "nothing": ({"lfe": {"period": 6000}}, "lfe", "estimates nothing"),
    "fading": ({"lfe": {"fading_tau": 60}}, "lfe.fading_tau", "both"),
    "offset": ({"star": {"time_offset": "late"}}, "star.time_offset", "a number"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_settings_name_the_key(name: str) -> None:
    document, field, part = BAD[name]
    with pytest.raises(InputError) as caught:
        Settings.from_dict(document)
    assert caught.value.field == field
    assert part in str(caught.value)


def test_what_an_orbit_filter_cannot_be() -> None:
    with pytest.raises(InputError, match="must be ekf or ukf"):
        navigator(filter={"kind": "srukf"})
    with pytest.raises(InputError, match="integrated by rk4"):
        navigator(filter={"kind": "ukf", "integrator": "exponential"})
    with pytest.raises(InputError, match=r"add a line sigma = \.\.\. to the table \[gnss\]"):
        Settings.from_dict({"orbit": {"gravity": 8}}).gnss_navigator()
