"""What the tests of simulated GPS and star-sensor trials share."""

from __future__ import annotations

from typing import Any

import numpy as np
from celestcore import orbit, quaternion
from celestcore.gnss.profile import AttitudeProfile, Slew
from celestcore.gnss.scenario import GnssStarScenario, GnssStarTrial
from scipy import stats

Array = np.ndarray[Any, Any]
J2 = orbit.ForceModel.j2()
QUICK = GnssStarScenario(force=J2)
TRIALS = 40
SLEWS = {
    "none": AttitudeProfile(),
    "return": AttitudeProfile(slew=Slew(np.radians(120.0), 1200.0, "return")),
    "turn": AttitudeProfile(slew=Slew(np.radians(120.0), 1200.0)),
    "large": AttitudeProfile((1.0, 900.0), (0.5, 600.0), (2.0, 400.0)),
}


def pooled(scenario: GnssStarScenario, what: Any, trials: int = TRIALS) -> Array:
    """Return what each trial gives, one below the other."""
    return np.array([what(scenario.trial(11, k)) for k in range(trials)])


def star_error(made: GnssStarTrial) -> Array:
    q = made.log.stars["star"].q
    return quaternion.log(quaternion.multiply(quaternion.conjugate(made.q_ib), q))


def gnss_error(made: GnssStarTrial) -> Array:
    table = made.log.gnss
    assert table is not None
    assert table.v is not None
    return np.hstack([table.r - made.r_e, table.v - made.v_e])


def assert_normal(x: Array, sigma: float) -> None:
    """Normal with this sigma: its spread within 5 standard errors, and its shape."""
    scaled = x.reshape(-1) / sigma
    assert abs(scaled.std() - 1.0) < 5.0 / np.sqrt(2.0 * scaled.size)
    assert stats.kstest(scaled, "norm").pvalue > 1e-4
