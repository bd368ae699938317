"""Scenarios that cannot be."""

from __future__ import annotations

from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import orbit
from celestcore.gnss.profile import AttitudeProfile, Slew
from celestcore.gnss.scenario import GnssStarScenario

J2 = orbit.ForceModel.j2()
BAD: dict[str, tuple[dict[str, Any], str]] = {
    "no epoch": ({"epoch": None}, "epoch.*is needed"),
    "epoch": ({"epoch": "yesterday"}, "epoch.*ISO"),
    "orbit": ({"orbit": (7e6, 0, 0, 0, 0, 0)}, "orbit.*Elements"),
    "force": ({"force": "j2"}, "force.*ForceModel"),
    "both": ({"force": J2, "gravity": orbit.GravityField.jgm3()}, "gravity.*force model"),
    "gravity": ({"gravity": 70}, "gravity.*GravityField"),
    "duration": ({"duration": -1.0}, "duration.*greater than 0"),
    "step": ({"step": 0.0}, "step.*greater than 0"),
    "gnss step": ({"gnss_step": np.nan}, "gnss_step.*finite"),
    "attitude": ({"attitude": [0.0]}, "attitude.*AttitudeProfile"),
    "sigma": ({"gnss_sigma": -1.0}, "gnss_sigma.*at least 0"),
    "velocity": ({"gnss_sigma_velocity": -1.0}, "gnss_sigma_velocity.*at least 0"),
    "markov": ({"gnss_markov": (1.0, 0.0)}, "gnss_markov.*correlation time"),
    "markov shape": ({"lfe_markov": 1.0}, "lfe_markov.*shape"),
    "outliers": ({"gnss_outliers": (1.5, 20, 200)}, "gnss_outliers.*fraction"),
    "outliers' order": ({"star_outliers": (0.5, 200, 20)}, "star_outliers.*fraction"),
    "lever arm": ({"lever_arm": [1.0, np.nan, 0.0]}, "lever_arm.*finite"),
    "star sigma": ({"star_sigma": 20.0}, "star_sigma.*ARCSEC"),
    "negative star sigma": ({"star_sigma": -1e-4}, "star_sigma.*negative"),
    "lfe": ({"lfe": (10.0, 3.0)}, "lfe.*ARCSEC"),
    "mounting": ({"star_mounting": [1.0, 1.0, 0.0, 0.0]}, "star_mounting.*norm"),
    "gyro": ({"gyro": cc.Gyro(arw=1e-6)}, "gyro.*GyroErrors"),
    "one baseline": ({"baselines": [[1.0, 0.0, 0.0]]}, "baselines.*two"),
    "offset": ({"star_offset": np.inf}, "star_offset.*finite"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_scenarios(name: str) -> None:
    options, match = BAD[name]
    with pytest.raises(cc.InputError, match=match):
        GnssStarScenario(**options)


def test_a_step_longer_than_the_flight() -> None:
    with pytest.raises(cc.InputError, match=r"duration.*1 epochs"):
        GnssStarScenario(force=J2, duration=5.0).trial()


@pytest.mark.parametrize(("seed", "trial"), [(-1, 0), (0, -1), (0.5, 0), (2**64, 0), (0, 2**56)])
def test_seeds(seed: Any, trial: Any) -> None:
    with pytest.raises(cc.InputError, match=r"seed|trial"):
        GnssStarScenario(force=J2).trial(seed, trial)


def test_profiles() -> None:
    with pytest.raises(cc.InputError, match=r"yaw.*period"):
        AttitudeProfile(yaw=(0.1, 0.0))
    with pytest.raises(cc.InputError, match=r"pitch.*amplitude"):
        AttitudeProfile(pitch=(20.0, 600.0))
    with pytest.raises(cc.InputError, match=r"slew"):
        AttitudeProfile(slew=120.0)  # type: ignore[arg-type]
    with pytest.raises(cc.InputError, match=r"slew\.angle.*radians"):
        Slew(120.0)
    with pytest.raises(cc.InputError, match=r"slew\.kind.*turn, return"):
        Slew(kind="there")
    with pytest.raises(cc.InputError, match=r"slew\.duration"):
        Slew(duration=0.0)
