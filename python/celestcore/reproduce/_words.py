"""What the page says in plain words: what must not be claimed, what was inferred, what is wrong."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from celestcore.reproduce._targets import difference, out_of_reach

if TYPE_CHECKING:
    from celestcore.reproduce.star_gyro import Result

FILTERS = {
    "mekf": "MEKF (tuned)",
    "ukf": "UKF, 6 error states, Runge-Kutta (tuned)",
    "ukf7": "the paper's 7-state UKF, repaired (tuned)",
    "smoothed": "MEKF, smoothed forward and backward",
}


def count(result: Result, column: str) -> int:
    """Return how many figures of a paper's column lie below the bound of causal filters."""
    return int(np.sum(out_of_reach(result, column)))


def not_claimed(result: Result) -> list[str]:
    """Return what must not be claimed, with this run's numbers."""
    tuned, paper = result.figures("mekf"), result.figures("paper_ukf")
    below = int(np.sum(tuned < paper))
    swap = max(difference(result, f"r{k}", f"r{k}_swapped") for k in (1, 2))
    return [
        "That a UKF is 10 to 20 % better than an EKF at arcsecond noise. With the same tuning the "
        f"two agree (largest relative difference of an orbit's rms here: {swap:.0e}): an EKF tuned "
        "like block R1 gives the paper's UKF column, a UKF tuned like block R2 its EKF column. The "
        "published gain is a difference of tuning.",
        "That the tuning is the paper's. It does not give Q and R. Both were fitted to its tables, "
        "and another pair may fit as well.",
        f"That the tuned filter is better everywhere. It is below the paper's UKF in {below} of "
        f"108 figures and above it in the other {paper.size - below}. "
        f"{count(result, 'paper_ukf')} published UKF figures (and "
        f"{count(result, 'paper_ekf')} EKF figures) are below what any causal filter can "
        "reach under the convention used here, so they cannot be reproduced by an honest one; they "
        "are marked † in the tables.",
        "That “3 sigma” is known. The level of the quoted errors and results is inferred: it is "
        "the only one at which the published figures are possible for a causal filter.",
        "That the smoothed figures are for flight. A smoother uses the fixes that come later. It "
        "is not causal, and is for processing on the ground.",
        "That a sigma-point filter never pays. Block N shows where it does, and where an iterated "
        "filter does better still.",
    ]


INFERRED_LEAD = (
    "The paper leaves these out. Each was chosen so that its figures become possible, and each is "
    "a choice that the paper's authors may have made otherwise."
)
INFERRED = [
    "All quoted errors (camera 5, 2, 1″; gyro 0.2 to 2.4 ″/s) and all results are 3 sigma.",
    "A gyro error of g means white noise of g/3 a sample, held over 0.1 s; on top a bias, drawn "
    "with 1 ″/s (1 sigma) per axis, that walks with 1e-5 ″/s^1.5. In R1 and R2 it is drawn with "
    "0.01 ″/s.",
    "A star camera measures the two axes across its boresight with s/3 and nothing about it; the "
    "two cameras together give R = [Σ (I − u uᵀ)]⁻¹ (s/3)². Pitch is the weak axis.",
    "The axes are pitch about the orbit normal, roll about the flight direction, yaw about the "
    "nadir, in the order of the tables.",
    "A circular orbit, earth pointing, one orbit of 5659.4 s; fixes at every second gyro sample.",
    "The filter starts from the first fix with P0 = R and (1 ″/s)²; the first 1000 s are left out "
    "(for the smoother the last 1000 s too).",
    "The metric: 3 × rms of the error about each axis, just after each fix.",
    "α = 1 for the sigma points (κ = 3 − n and β = 2 are the paper's).",
    "R1: isotropic R = (s/3)² I, one process noise of 0.753 ″/s (3 sigma) for all 36 runs, no bias "
    "random walk. It was fitted to the errors at 10 Hz; 0.70 fits the errors just after fixes.",
    "R2: the same with 0.379 ″/s and a bias random walk of 3.07e-3 ″/s^1.5 (3 sigma).",
]
MISPRINTS = [
    "Eq. 13 lacks the term −½ Δq0 Δb. Without it the bias is never estimated. The 7-state filter "
    "here has it.",
    "Eq. 14, q_star ⊗ q_g⁻¹, is an error in inertial axes, while eq. 9 defines one in body axes. "
    "The 7-state filter here uses q_g⁻¹ ⊗ q_star.",
    "The 7 × 7 covariance is singular along Δq0, so that its square root does not exist: the "
    "repaired filter starts with P00 = (s/2)² and renormalises, or takes a semidefinite root.",
    "The boresights of Table 1 are 114.975° apart; the paper prints 114.9°.",
    "Three roll figures of Table 3 are printed as “1.370 8”, “1.570 7”, “1.699 1”: decimals parted "
    "by threes and not rounded like the others. They are taken as 1.3708, 1.5707 and 1.6991.",
    "The Earth's radius (6371 km), the right ascension of the node (“rad(140 000)”) and its rate "
    "are printed in Table 1 and have no part in these results.",
    "The random drift d of eq. 8 is in the gyro model, but no number is given for it: it is zero.",
]
COST = (
    "The paper counts a UKF prediction as 2n + 1 EKF predictions: 15 for its seven states, 13 for "
    "six. The time measured is far below that: the gyro propagation of the points is done for "
    "several at once, and they share the work that is not theirs."
)
ERROR_FREE = (
    "The paper names runs without sensor errors and gives no result. Here the filter is told of "
    "1e-3 (3 sigma) where there is nothing; what is left is the other sensor's share, or rounding. "
    "One orbit each."
)
FORMS = (
    "“Textbook” is the form in which the filters are published: both vectors in one update, with "
    "the residual b − A r. “Library” is celestcore's own: one direction after the other, with the "
    "arc across the direction as residual. That alone makes an EKF go wrong less often. The "
    "library's USQUE row is its unscented filter with the spread of USQUE (n + λ = 7, β = 0), the "
    "UKF row the same filter as delivered (n + κ = 3, β = 2). No more is claimed for N1 than: at "
    "90° iterated at most 2 %, invariant at most 12 %, MEKF and USQUE in textbook form at least "
    "35 %; at 150° iterated at most 2 %, the other textbook forms at least 75 %. The share for an "
    "unscented filter in N3 has not been checked against the literature."
)
N_CASES = [
    "N1, two vectors: two inertial directions 20 to 160° apart, 0.1°, and a gyro of 5 °/h, at 1 Hz "
    "for 600 s; the start is off by exactly 90° or 150°. Not settled: above 0.2° in more than 5 % "
    "of the last 120 s.",
    "N2, slow fixes: a bias of 1 °/s, a swinging body, and 30 fixes of 10″ every 30, 60 or 120 s. "
    "Medians of the error of the bias; NEES over its 6 degrees of freedom should be 1.",
    "N3, a magnetometer alone: 350 km, 35°, a tilted dipole, 50 nT every 10 s for 8 h; the start "
    "is off by 50° per axis. Not settled: not below 0.1° throughout the last fifth.",
]
RUN = [
    "The bounds come from the discrete Riccati equation of each cell "
    "(celestcore.analysis.steady_state).",
    "The standard error of an orbit's rms is computed from the autocorrelation of the settled "
    "error: from 0.7 % to 7 % an orbit, more for better gyros. It agrees with the scatter found.",
    "Three standard errors are exceeded by one of 108 figures in one seed of six, by chance alone. "
    "So one figure outside is not counted as a miss, and two are.",
    "Every filter of a block runs on the same noise, so that they can be compared to many digits.",
]


def wins(better: int, equal: int) -> str:
    """Say how often the paper's EKF is at least as good as its UKF."""
    return (
        f"In {better + equal} figures the paper's EKF is at least as good as its UKF: {better} "
        f"where it is better and {equal} where they are equal, all with the best gyros (‡ in the "
        "tables). The gains printed in the text for the 2″ and the 1″ camera are larger than the "
        "means over its tables; they are near the means over those figures alone that its UKF wins."
    )


def block_n(runs: int) -> str:
    """Introduce block N."""
    return (
        "At arcsecond noise the problem is linear, and no filter can show what it is good for. "
        f"These three are not linear ({runs} seeded runs each)."
    )
