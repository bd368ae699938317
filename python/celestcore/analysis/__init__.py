"""What the sensors can give, and whether a filter's errors are what it says.

- `steady_state`: the accuracy that a gyro and a star camera can reach, filtered and smoothed;
  `required_gyro`, `required_star`, `plot_requirements` ask the other way round.
- `nees`, `nis`, `consistency`, `whiteness`: errors and innovations against their covariances.
- `allan_deviation`, `fit_allan`, `plot_allan`: the noise of a gyro from its log.
- `estimate_noise`: the noise of gyro and star camera from the innovations of a filter.
- `withheld_drift`, `withheld_orbit`: how good predictions without fixes are, of attitude and orbit.
- `nadir_pointing`: how a body keeps to the geodetic nadir of its own GNSS fixes.
- `posterior_bound`: the accuracy that no filter of an orbit can beat; `trade`, `plot_trade`: which
  stars, filter period, gravity and number of cameras.

Examples
--------
>>> import celestcore as cc
>>> bound = cc.analysis.steady_state(cc.Gyro(arw=1e-6, rrw=1e-9), 5 * cc.ARCSEC, 0.1, 0.2)
>>> (bound.sigma_filter[:3] / cc.ARCSEC).round(3)
array([0.68, 0.68, 0.68])
"""

from celestcore._analysis_plots import plot_allan, plot_requirements, plot_trade
from celestcore.analysis.allan import AllanDeviation, AllanFit, allan_deviation, fit_allan
from celestcore.analysis.autocorrelation import Whiteness, whiteness
from celestcore.analysis.bound import PosteriorBound, posterior_bound
from celestcore.analysis.chi_square import Consistency, consistency, nees, nis
from celestcore.analysis.drift import WithheldDrift, withheld_drift
from celestcore.analysis.noise import NoiseEstimate, estimate_noise
from celestcore.analysis.orbit import WithheldOrbit, withheld_orbit
from celestcore.analysis.pointing import NadirPointing, nadir_pointing
from celestcore.analysis.requirements import required_gyro, required_star
from celestcore.analysis.steady import SteadyState, steady_state
from celestcore.analysis.trade import Trade, trade

__all__ = [
    "AllanDeviation",
    "AllanFit",
    "Consistency",
    "NadirPointing",
    "NoiseEstimate",
    "PosteriorBound",
    "SteadyState",
    "Trade",
    "Whiteness",
    "WithheldDrift",
    "WithheldOrbit",
    "allan_deviation",
    "consistency",
    "estimate_noise",
    "fit_allan",
    "nadir_pointing",
    "nees",
    "nis",
    "plot_allan",
    "plot_requirements",
    "plot_trade",
    "posterior_bound",
    "required_gyro",
    "required_star",
    "steady_state",
    "trade",
    "whiteness",
    "withheld_drift",
    "withheld_orbit",
]
