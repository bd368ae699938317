"""What the page says in plain words: what must be said, what was inferred, what is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

from celestcore.reproduce._gnss_targets import outlier_ratios, slew_ratio, value
from celestcore.units import ARCSEC, DEG

if TYPE_CHECKING:
    from celestcore.reproduce.gnss_star import Result


def said_plainly(result: Result) -> list[str]:
    """Return what must be said plainly, with this run's numbers."""
    return [
        _paper_pitch(result),
        _antennas(result),
        _baselines(result),
        _independent(result),
        _raw(result),
        _lfe(result),
        _coloured(result),
        _kinematic(result),
        "The filter with 20×20 gravity shares the truth's field, as no filter in orbit does; what "
        "it leaves out are degrees 21 to 70, drag, sunlight, Sun and Moon. The rows with 8×8, 4×4 "
        "and zonal gravity show what a poorer field costs.",
        "The contents of the paper's Tables 1 and 2 are not legible in the copy this was made "
        "from. Of its figures only one sentence is: pitch rms below 0.02° with 10 m GPS. There is "
        "nothing else to put beside the figures here.",
        "Smoothers use the fixes that come later. They are not causal, and are for work on the "
        "ground.",
    ]


def _paper_pitch(result: Result) -> str:
    star, ours = value(result, "pitch_star", 10.0), value(result, "pitch_lfe", 10.0)
    return (
        "The paper's 0.02° of pitch error is 72″: worse than its own star sensor, whose noise is "
        f"20″ (raw fixes here: {star:.1f}″). A filter on the star sensor alone has "
        f"{ours:.1f}″ with the low-frequency error in it."
    )


def _antennas(result: Result) -> str:
    found = [row.pitch / DEG for row in result.antennas]
    return (
        "GPS antenna positions of 1 m on baselines of metres carry no attitude: the direct method "
        f"has {found[0]:.0f}° of pitch error (rms) with 1 m and {found[1]:.0f}° with 10 m, where "
        "blind guessing has 39°."
    )


def gains(result: Result) -> list[float]:
    """Return by how much baselines lower the attitude's errors: roll, pitch, yaw, relative."""
    return [
        1.0 - value(result, f"{axis}_baselines") / value(result, f"{axis}_no_lfe")
        for axis in ("roll", "pitch", "yaw")
    ]


def _baselines(result: Result) -> str:
    shown = " / ".join(f"{100.0 * g:.1f}" for g in gains(result))
    own = value(result, "pitch_gps_baselines_5mm") * DEG / ARCSEC
    scheme = value(result, "pitch_paper_scheme_5mm")
    return (
        f"Carrier-phase baselines of 5 mm have {own:.0f}″ of pitch error by themselves. Added to "
        f"the star sensor they lower the errors by {shown} % (roll / pitch / yaw). "
        "The paper's own scheme, one filter for each angle's difference GPS less star, has "
        f"{scheme:.3f}° = {scheme * DEG / ARCSEC:.0f}″ with them and the process noise that serves "
        "it best: it replaces the star sensor's noise by that of the baselines."
    )


def _independent(result: Result) -> str:
    one, ten = (value(result, "pitch_lfe", gps) for gps in (1.0, 10.0))
    return (
        "Attitude accuracy does not depend on GPS noise: the pitch error is "
        f"{one:.2f}″ with 1 m and {ten:.2f}″ with 10 m. Not a better weighting does that, as the "
        "paper has it, but that GPS says nothing of the attitude to begin with."
    )


def _raw(result: Result) -> str:
    star, slow = (value(result, f"pitch_{name}") for name in ("star", "star_lfe"))
    no_lfe, smoothed = (value(result, f"pitch_{name}") for name in ("no_lfe", "no_lfe_smoothed"))
    return (
        f"The raw star sensor has {star:.1f}″ ({slow:.1f}″ with its low-frequency error) and "
        "stands beside every attitude figure. Filtering brings "
        f"{no_lfe:.1f}″, smoothing {smoothed:.1f}″."
    )


def _lfe(result: Result) -> str:
    states, ignored = (value(result, f"pitch_{name}") for name in ("lfe", "lfe_ignored"))
    honest, not_honest = (value(result, f"nees_attitude_{name}") for name in ("lfe", "lfe_ignored"))
    gyro, without = (
        value(result, f"pitch_gyro_{name}_smoothed") for name in ("lfe", "lfe_ignored")
    )
    return (
        "Over 20 minutes, a fifth of an orbit, the low-frequency error cannot be told from the "
        f"attitude: its states change nothing ({states:.2f}″, without them {ignored:.2f}″) but the "
        f"filter's honesty (NEES {honest:.2f} instead of {not_honest:.2f}). With a gyro over three "
        f"orbits they bring {gyro:.1f}″ instead of {without:.1f}″, smoothed. Two of the six "
        "combinations of the first harmonic stay unseen even then: a mix of roll and yaw that "
        "looks like a constant inertial error."
    )


def _coloured(result: Result) -> str:
    return (
        "Real GPS errors are coloured. A Gauss-Markov error of 1 m and 1800 s breaks the targets "
        f"of white noise: with bias states {value(result, 'position_coloured'):.2f} m and NEES "
        f"{value(result, 'nees_coloured'):.1f} of 6, without "
        f"{value(result, 'position_coloured_ignored'):.2f} m and "
        f"{value(result, 'nees_coloured_ignored'):.0f}."
    )


def _kinematic(result: Result) -> str:
    shown = [
        f"{value(result, 'position_kinematic', gps):.2f} m filtered and "
        f"{value(result, 'position_kinematic_smoothed', gps):.2f} m smoothed with {gps:g} m GPS"
        for gps in (1.0, 10.0)
    ]
    return (
        "What the paper could reach for position, one kinematic filter for each coordinate with "
        f"the process noise that serves it best: {', '.join(shown)}. Orbit dynamics do better."
    )


INFERRED_LEAD = (
    "The paper leaves these out. Each is a choice that its authors may have made otherwise."
)
INFERRED = [
    "The orbit: osculating a = 6884.0 km, e = 0.0012, i = 97.42°, node 100.3°, perigee 90°, mean "
    "anomaly 30° at 2019-01-21T04:00:00 UTC; the paper takes telemetry of ZY-3.",
    "Truth: EGM2008 70×70, Harris-Priester drag (Cd 2.2, 12 m², 2650 kg), radiation pressure (Cr "
    "1.3, 12 m²), Sun, Moon; 121 epochs at 10 s.",
    "Attitude about the orbital frame, 3-2-1: yaw 0.04° with a period of 900 s, pitch 0.02° with "
    "600 s, roll 0.03° with 400 s, random phases.",
    "GPS: white noise of 1 or 10 m on each axis, and of 0.01 or 0.1 m/s on velocities; the paper "
    "gives one number.",
    "The star sensor's 20″ hold about each axis. Its low-frequency error has 10″ at the orbit's "
    "frequency and 3″ at twice that, about each axis with random phases; the paper names it and "
    "gives no size.",
    "The process noise Q of the paper's filters (white jerk, [T⁵/20, T⁴/8, T³/6; ·, T³/3, T²/2; "
    "·, ·, T]) and their start P0 (a parabola through three samples) are inferred: its equations "
    "13 and 14 are not legible. Where such a filter is shown, its density was searched for the "
    "best.",
    "Process noise of the orbit filters [m²/s³]: 1e-8 (20×20), 1e-7 (8×8), 1e-6 (4×4), 3e-6 "
    "(zonal). White angular jerk of the attitude filter: 1e-16 rad²/s⁵.",
    "Gyro, where there is one: angle random walk 0.005°/√h, rate random walk 0.01°/h/√h, bias "
    "1°/h, samples each second.",
    "Baselines: (2, 0, 0) and (0, 1.5, 0) m, 5 mm on each axis, of which half the variance is the "
    "master antenna's.",
    "Scored: filters after 300 s, smoothers at all epochs; rms pooled over the runs; max is the "
    "mean over the runs of the largest error.",
]
MISPRINTS = [
    "The body frame of the text (x forward, y right, z up) is left-handed. Here z points to nadir, "
    "which changes the signs of pitch and roll in its equations 1 to 5.",
    "“Estimation accuracy equal to that with an inertial system” has nothing to compare with: a "
    "gyro, run here, does make a difference.",
    "That the filter gives the star sensor more weight when GPS gets worse does not explain a "
    "pitch error that stays the same: with antenna positions its weight is all along one.",
]
POSITION = (
    "3D errors in m; max is the mean over the runs of the largest error. Asked: at most so much, "
    "and in brackets the bound; brackets alone are what an independent prototype found, and no "
    "target. The best kinematic filters work on positions and velocities of each Earth-fixed "
    "coordinate with white jerk; the smoothed one is scored from the third epoch on, as its start "
    "takes three. NEES / 6 is 1 where errors are as large as the filter says; below 1 the process "
    "noise is larger than need be."
)
ATTITUDE = (
    "Errors in arcsec about the body's axes, at 1 m GPS; at 10 m they are the same. The floor that "
    "the low-frequency error itself sets is 7.4″: the rms of 10″ and 3″ sines."
)
GYRO = (
    "Three orbits with a gyro at 1 m GPS, in arcsec. Sampled every 2 s instead of 1 s, the gyro "
    "costs about 1″ of the smoothed pitch."
)
OUTLIERS = "Each fix of either sensor is wrong with a probability of 5 %, by 20 to 200 sigma."
SLEW = (
    "The body turns in pitch at a constant 0.1° a second, past 90° after 15 minutes. The Euler "
    "filters (the paper's, here on the star sensor's own angles) see yaw and roll jump by half a "
    "turn, and take it for motion; the navigator works on quaternions and does not notice. A slew "
    "that turns back has a jerk of its own: the navigator must be told so by a larger density, "
    "and is then little better than the raw star sensor. With the density of nominal flight the "
    "filter lags, refuses its fixes and is lost."
)
COLOURED = "Gauss-Markov error of GPS positions, 1 m and 1800 s, on top of 1 m of white noise."
OBSERVED = (
    "Left: the covariance of the first harmonic's six coefficients after three orbits with a "
    "gyro, along its principal axes, against the prior. Right: the low-frequency error in pitch "
    "as those coefficients have it."
)
COVARIANCE = (
    "Attitudes from 2, 3 and 4 baselines by least squares (Wahba), all of which share the master "
    "antenna: scatter of the draws against the covariance that the method tells, in all of them "
    "together (Frobenius norm) and axis by axis."
)
TRACKS = (
    "At the scale of the track nothing can be told apart, as in the paper's figures; below them "
    "the heights, of which the fixes' noise and the filter's can be seen."
)


def few(result: Result) -> str:
    """Warn of a quick run."""
    return (
        f"A run with few trials ({result.runs} a cell; the targets are defined for 100): no target "
        "is judged (–). Leave out --quick and --runs for the figures to quote."
    )


def lead(result: Result) -> str:
    """Return the outcome in a few sentences."""
    position = [value(result, "position_20x20", gps) for gps in (1.0, 10.0)]
    smooth = [value(result, "position_20x20_smoothed", gps) for gps in (1.0, 10.0)]
    pitch, smoothed = (value(result, f"pitch_{name}") for name in ("lfe", "lfe_smoothed"))
    worst = max(max(ratios) for ratios in outlier_ratios(result).values())
    return (
        f"Position {position[0]:.2f} m (1 m GPS) and {position[1]:.1f} m (10 m GPS) by a filter "
        f"with 20×20 gravity, {smooth[0]:.2f} and {smooth[1]:.1f} m smoothed. Pitch {pitch:.1f}″, "
        f"smoothed {smoothed:.1f}″, at either level, from a star sensor of "
        f"{value(result, 'pitch_star_lfe'):.1f}″; the paper says below 72″. With 5 % outliers, gated, "
        f"errors grow by at most a factor {worst:.2f}, in a slew through 90° of pitch by "
        f"{slew_ratio(result):.2f}, where the paper's Euler filters fail."
    )
