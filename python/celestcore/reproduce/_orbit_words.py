"""What the orbit page says in plain words: what must be said, what was inferred, what is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_model import PERIODS, Cell
from celestcore.reproduce._orbit_targets import difference, listed, means

if TYPE_CHECKING:
    from celestcore.reproduce.celestial_orbit import Result


def said_plainly(result: Result) -> list[str]:
    """Return what must be said plainly, with this run's numbers."""
    return [
        _upf(result),
        _taylor(result),
        _not_reproduced(result),
        _pays(result),
        _starts(result),
        "That these are the paper's conditions is inferred. It gives neither epoch nor boresight "
        "nor number of stars, nor Q, nor how often it was run; what was chosen is listed below. It "
        "is the one reading found under which its UKF column comes out.",
        "21×21 gravity shares the truth's field, as no filter in orbit does. The conservative "
        f"figures are those of 8×8 gravity: {listed(means(result, 'ekf_8x8'))} m for noise A.",
        "Noise A treats the horizon's error as new in each star angle. In a real sensor all angles "
        "of an epoch share one error of the nadir direction (noise B), and more stars do not "
        f"average it away: the UKF has {listed(means(result, 'ukf', 'B'))} m instead of "
        f"{listed(means(result, 'ukf'))} m. Noise B stands beside A throughout.",
        "The smoother uses the angles that come later. It is not causal, and is for work on the "
        "ground.",
    ]


def _upf(result: Result) -> str:
    gaps = [row["UKF"].mean_pos - row["UPF"].mean_pos for row in _printed()]
    runs = [result.cells[Cell(p)]["ukf"].scatter() for p in PERIODS]
    return (
        "That an unscented particle filter is better than a UKF under normal noise is not "
        f"reproducible. EKF (Runge-Kutta) and UKF differ by {difference(result, 'ekf'):.2f} m at "
        f"most, the particle filter by {difference(result, 'upf'):.2f} m: the problem is too "
        f"nearly linear for either to gain. The paper's gaps, {listed(gaps)} m, are about one "
        f"standard deviation of a single run ({listed(runs)} m), and it shows single runs."
    )


def _printed() -> list[dict[str, paper.Row]]:
    """Return the paper's rows at all four periods, normal noise."""
    return [
        paper.TABLE_2["normal"] if period == paper.PERIOD_2 else paper.TABLE_1[period]
        for period in PERIODS
    ]


def _taylor(result: Result) -> str:
    return (
        "The paper's EKF degrades with the period because of its discretisation, not of "
        "linearisation: its second-order Taylor step over T (eqs. 5, 10) gives "
        f"{listed(means(result, 'ekf_taylor'))} m at T = 3 / 15 / 30 / 60 s, the same EKF with a "
        f"Runge-Kutta step {listed(means(result, 'ekf'))} m."
    )


def _not_reproduced(result: Result) -> str:
    other = ("student_t", "uniform")
    ours = [result.cells[Cell(15.0, "A", d)]["ekf_taylor"].mean() for d in other]
    theirs = [paper.TABLE_2[d]["EKF"].mean_pos for d in other]
    ekf = [row["EKF"].mean_pos for row in _printed()]
    return (
        "Some of the paper's EKF figures do not come out under this reading: it has "
        f"{listed(ekf[2:])} m at T = 30 / 60 s (here {listed(means(result, 'ekf_taylor')[2:])} m), "
        f"and {listed(theirs)} m for t and uniform noise (here {listed(ours)} m, hardly less than "
        "for normal noise, as a filter that only knows the variance must have it)."
    )


def _pays(result: Result) -> str:
    t_noise, uniform = (result.cells[Cell(15.0, "A", d)] for d in ("student_t", "uniform"))
    gated, plain = result.outliers["ekf_gated"].mean(), result.outliers["ukf"].mean()
    ukf, better, smooth = (means(result, name) for name in ("ukf", "ekf_21x21", "smoothed_21x21"))
    return (
        "What does pay. Dynamics in the filter: 21×21 gravity instead of J2 gives "
        f"{listed(better)} m instead of {listed(ukf)} m. A likelihood that matches the noise: the "
        f"score filter has {t_noise['score'].mean():.0f} m under t noise and "
        f"{uniform['score'].mean():.0f} m under uniform noise, the UKF "
        f"{t_noise['ukf'].mean():.0f} and {uniform['ukf'].mean():.0f} m. Gating: with 5 % outliers "
        f"of 50 sigma at T = 60 s the UKF has {plain:.0f} m, an EKF with a gate {gated:.0f} m. "
        f"Smoothing: {listed(smooth)} m."
    )


def _starts(result: Result) -> str:
    """Say how many runs converge, by the form of the measurement."""
    said = []
    for start in dict.fromkeys(row["start"] for row in result.starts):
        rows = [row for row in result.starts if row["start"] == start]
        for apart, how in ((False, "combined"), (True, "one by one")):
            found = [r for r in rows if r["filter"].endswith("_apart") == apart]
            if found:
                worst = min(found, key=lambda r: r["converged"])
                said.append(
                    f"from {start} with angles {how}: {worst['converged']} of {worst['of']} runs "
                    f"at least ({worst['what'].split(',')[0]})"
                )
    return (
        "From large errors the form of the measurement decides more than the filter: angles that "
        "are first combined to the nadir direction are nearly linear. Converged "
        f"{'; '.join(said)}."
    )


INFERRED_LEAD = (
    "The paper leaves these out. Each is a choice that its authors may have made otherwise."
)
INFERRED = [
    "Epoch 2007-07-01T12:00 UTC; true anomaly 0; the elements are osculating.",
    "Truth: JGM-3 21×21 (C20 = −4.84169548456e-4, zero tide), Sun, Moon, radiation pressure (Cr 1, "
    "0.02 m²/kg, 4.56e-6 N/m², conical shadow), Harris-Priester drag (Cd 2, 0.02 m²/kg, lag 30°, "
    "exponent 6), integrated to 1e-12 by an adaptive method of order 8 for 600 min.",
    "Stars: Hipparcos-2 to Hp 6.0 for the paper's Tycho, proper motion to 2007.5, no aberration in "
    "truth or filter.",
    "The camera's field of 10×10° is centred on the zenith, one side along-track; the six "
    "brightest stars in it are used, none behind the Earth or within 100 km above it.",
    "Noise A: each star angle has an independent error, σ = hypot(0.02°, 3″). Noise B: one error "
    "of the nadir direction, 0.02° on each of two axes, shared by all angles of an epoch, and 3″ "
    "a star: R = (3″)² I + (0.02°)² E Eᵀ.",
    "t noise: 3 degrees of freedom, scaled to the same variance as the normal noise; uniform "
    "noise: ±√3 σ. The filters that use the likelihood are given the same law, the uniform one "
    "with soft edges exp(−½((|d| − b)/(e b))²): e = 0.05 for the particle filters, 0.01 for the "
    "score filter.",
    "The filters' J2 model: JGM-3's mu, radius and J2 = 1.0826360e-3 about the z axis of the "
    "GCRF; RK4 steps of at most 30 s; white acceleration of 4e-7 m²/s³ (flat from 1e-7 to 8e-7). "
    "8×8 with Sun and Moon: 4e-9; 21×21: 3e-11 (with 1e-9 and 1e-12 their errors are the same to "
    "2 m, but NEES / 6 is 1.35 and 1.2 at T = 3 s). The Taylor EKF: 1e-6 / 3e-6 / 1e-4 / 1e-2 at "
    "T = 3 / 15 / 30 / 60 s. The score filter with J2 under uniform noise: 1e-6; the bootstrap "
    "filter: 3e-4.",
    "Start: 1 km and 1 m/s per axis (1 sigma), P0 the same. Scored: mean and maximum over t ≥ 200 "
    "min, then the mean over the runs.",
    "The paper's “TABLE 2” period, 15 s, stands beside Table 1's three periods.",
]
MISPRINTS = [
    "Eq. 1 has J2 (Re/r) where it must be (Re/r)². Taken literally the orbit ends 16 km off.",
    "Eq. 10 lacks an f: the last term is A f T²/2, as in eq. 5.",
    "The UKF's largest position error at T = 3 s (Table 1) and that for normal noise at T = 15 s "
    "(Table 2) are the same number, 540.5632 m: one of them must be a copy.",
    "The weight of the particles (section 3.3, step 2) is divided by q(x | x, z of the step "
    "before); the proposal is drawn with the measurement of this step.",
    "The text has an orbit of 1 h; it is 100 min, of which 600 min hold exactly six.",
    "The text counts the UKF as 4 times the EKF (953 over 240, F diagonal) and the UPF as 20 times "
    "the UKF; its own times are 1.5, 3.5 and 60 s.",
]
PARTICLES = (
    "The paper's literal steps (section 3.3) let every particle run its own UKF, draw from it, "
    "and weight with transition over proposal. The transition density is far narrower than the "
    "proposal (the process noise of one step is centimetres to metres, the proposal hundreds of "
    "metres), so one particle gets all the weight: the effective sample size collapses to 1, and "
    "the error grows to kilometres at any Q and number of particles tried. A bank of UKFs, "
    "weighted by their innovations, does not collapse and equals the UKF. The form offered as the "
    "default draws pairs x̄ ± L n from one UKF's posterior and weights them with likelihood × "
    "N(x; x⁻, P⁻) / N(x; x̄, P): nothing is lost under normal noise, and the likelihood's shape "
    "is used under any other. The bootstrap filter, beside them, has no Kalman filter to lean on: "
    "six dimensions are many for 1000 particles, and it needs a process noise a thousand times "
    "that of the others to keep them apart. A run is lost if its mean error is above 10 km."
)
SHAPES = (
    "Uniform noise at T = 15 s, the score filter. What it is told of the edges decides what it "
    "gains: softer edges than there are throw most of it away, and a half-width that is 5 % too "
    "wide makes the error of the filter with 21×21 gravity several times as large. A filter that "
    "only knows the variance does not care."
)
COST = (
    "The paper's formulas count the multiplications of one step for n = 6; “F diagonal” does not "
    "hold for an orbit, where the transition couples position and velocity. What costs time is "
    "the acceleration: its evaluations a step are counted for a Runge-Kutta step of 3 s. An orbit "
    "is 2000 steps. Measured with one thread, on this machine."
)
OUTLIERS = (
    "Each angle is wrong by 50 sigma more, to either side, with a probability of 5 %; T = 60 s. A "
    "gate rejects an angle whose innovation is improbable; Huber's weights bound what one angle "
    "can do; the score filter and the particle filter are told that the noise is Student's t."
)
STARTS = (
    "The start is off by normal errors of this size per axis, P0 the same; T = 15 s, noise A. A "
    "run converges if its position error stays below 5 km over the last orbit. Angles that are "
    "first combined to the nadir direction are a nearly linear measurement, whatever the start; "
    "one after the other, with the star close to the zenith, they are not."
)
REFRACTION = (
    "The second way of the paper's introduction, for which it gives no results: the refraction "
    "angle of a star seen through the atmosphere at 20 to 50 km, noise 3″, and 1 % error of the "
    "air's density drawn for each occultation. T = 15 s, spherical Earth. Few runs: take the "
    "expected figures and these as orders of magnitude. Published figures are 38 to 131 m."
)


def sky(result: Result) -> str:
    """Say how many stars there are and are seen."""
    seen = result.sky
    return (
        f"{seen['stars']:.0f} stars to Hp 6.0; of at most six, {seen['mean']:.2f} are seen on "
        f"average and {seen['least']:.0f} at least."
    )


def few(result: Result) -> str:
    """Warn of a quick run."""
    return (
        f"A run with few trials ({result.runs} a cell): single runs scatter by 10 to 20 %, so most "
        "targets are not judged (–). Leave out --quick for the figures to quote."
    )


def lead(result: Result) -> str:
    """Return the outcome in a few sentences."""
    ukf, printed = means(result, "ukf"), [row["UKF"].mean_pos for row in _printed()]
    ratio = np.divide(ukf, printed)
    outcome = "comes out" if np.all(np.abs(ratio - 1.0) < 0.2) else "comes near"
    return (
        f"The paper's UKF column {outcome}: {listed(ukf)} m at T = 3 / 15 / 30 / 60 s where it "
        f"prints {listed(printed)} m (ratios {listed(ratio.tolist(), 2)}). Its order of filters "
        "does not: an EKF with a Runge-Kutta step equals the UKF, and so does the particle "
        "filter, as long as the noise is normal. Better dynamics "
        f"({listed(means(result, 'ekf_21x21'))} m with 21×21 gravity), a likelihood that fits the "
        "noise, gating and smoothing are what pays."
    )
