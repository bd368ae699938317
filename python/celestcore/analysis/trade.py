"""`trade`: which stars, which period, which gravity, one camera or two."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._arguments import checked, count
from celestcore._check import FloatArray, array, number
from celestcore.analysis.bound import posterior_bound
from celestcore.errors import InputError
from celestcore.filters import EKF
from celestcore.orbit import ForceModel, OrbitDynamics, Trajectory

if TYPE_CHECKING:
    from celestcore.celestial import SkyCamera, StarHorizon

__all__ = ["Trade", "trade"]

PSD = {"J2": 4e-7, "8x8": 4e-9, "21x21": 3e-11}
"""Acceleration noise that goes with what each gravity leaves out in a low orbit [m^2/s^3]."""


@dataclass(frozen=True, eq=False, repr=False)
class Trade:
    """Accuracy over a grid of cameras, filter periods and dynamics.

    Attributes
    ----------
    cameras : tuple of str
        Names of the cameras or sets of cameras.
    periods : ndarray (p,)
        Filter periods [s].
    dynamics : tuple of str
        Names of the dynamics.
    stars : ndarray (c,)
        Stars seen at an epoch, on average, all cameras of a set together.
    bound : ndarray (c, p)
        Posterior Cramer-Rao bound with perfect dynamics: rms position [m].
    rms : ndarray (c, p, d)
        Rms position error over the runs [m].
    error : ndarray (c, p, d)
        Standard error of `rms` [m]; NaN for a single run.
    nees : ndarray (c, p, d)
        Mean normalised squared error; 6 where a filter's errors are as large as it says.
    runs : int
    smoother : bool

    Examples
    --------
    >>> import numpy as np
    >>> one = np.ones((1, 1))
    >>> made = Trade(("zenith",), np.array([15.0]), ("J2",), np.array([5.5]), 110 * one,
    ...              250 * one[..., None], 3 * one[..., None], 15 * one[..., None], 8, False)
    >>> made.rows()[0]["rms_m"]
    250.0
    """

    cameras: tuple[str, ...]
    periods: FloatArray
    dynamics: tuple[str, ...]
    stars: FloatArray
    bound: FloatArray
    rms: FloatArray
    error: FloatArray
    nees: FloatArray
    runs: int
    smoother: bool

    def __repr__(self) -> str:
        c, p, d = self.rms.shape
        return f"Trade({c} cameras, {p} periods, {d} dynamics, {self.runs} runs each)"

    def rows(self) -> list[dict[str, Any]]:
        """Return one row for each combination, ready for a table or JSON.

        Returns
        -------
        list of dict
            ``camera``, ``period_s``, ``dynamics``, ``stars``, ``rms_m``, ``rms_se_m`` (None for a
            single run), ``nees``, ``bound_m``.

        Examples
        --------
        >>> import numpy as np
        >>> one = np.ones((1, 1))
        >>> made = Trade(("zenith",), np.array([15.0]), ("J2",), np.array([5.5]), 110 * one,
        ...              250 * one[..., None], one[..., None], 15 * one[..., None], 1, False)
        >>> made.rows()[0]["rms_se_m"] is None
        True
        """
        return [
            {
                "camera": camera,
                "period_s": float(period),
                "dynamics": dynamics,
                "stars": float(self.stars[c]),
                "rms_m": float(self.rms[c, p, d]),
                "rms_se_m": float(self.error[c, p, d]) if self.runs > 1 else None,
                "nees": float(self.nees[c, p, d]),
                "bound_m": float(self.bound[c, p]),
            }
            for c, camera in enumerate(self.cameras)
            for p, period in enumerate(self.periods)
            for d, dynamics in enumerate(self.dynamics)
        ]


def trade(
    orbit: Trajectory,
    cameras: Mapping[str, SkyCamera | Sequence[SkyCamera]],
    horizon: StarHorizon,
    periods: Sequence[float] = (3.0, 15.0, 30.0, 60.0),
    dynamics: Mapping[str, OrbitDynamics] | None = None,
    *,
    runs: int = 8,
    seed: int = 0,
    smoother: bool = False,
    skip: float = 0.0,
    start_sigma: tuple[float, float] = (1e3, 1.0),
    threads: int | None = None,
    progress: Callable[[int, int], object] | None = None,
) -> Trade:
    """Compare cameras, filter periods and dynamics on one orbit.

    Each combination is flown in seeded runs with an extended filter, and held against the bound of
    perfect dynamics. All see the same random numbers as far as they see the same stars.

    Parameters
    ----------
    orbit : Trajectory
        The true orbit, with a state at every epoch of every period.
    cameras : dict of str to SkyCamera or sequence of SkyCamera
        What to compare: other fields, magnitudes or numbers of stars; one camera or two.
    horizon : StarHorizon
        Noise of the angles, simulated and told to the filter.
    periods : sequence of float
        Filter periods [s].
    dynamics : dict of str to OrbitDynamics, optional
        What the filter knows of the motion. J2; 8x8 and 21x21 with Sun and Moon unless given, each
        with the acceleration noise that works in a low orbit (4e-7, 4e-9, 3e-11 m^2/s^3).
    runs : int
        Runs of each combination.
    seed : int
        Of all random numbers.
    smoother : bool
        Compare smoothers and their bound; not causal.
    skip : float
        Time at the start that is left out of the scores [s].
    start_sigma : (position, velocity)
        1-sigma of the start [m], [m/s].
    threads : int, optional
        The machine's, by default; the figures are the same for any number.
    progress : callable, optional
        ``progress(done, total)`` in runs.

    Returns
    -------
    Trade

    Raises
    ------
    InputError
        Names the field and the value.
    KeyboardInterrupt
        On Ctrl-C.

    Examples
    --------
    >>> import numpy as np
    >>> import celestcore as cc
    >>> j2 = cc.orbit.ForceModel.j2()
    >>> orbit = cc.orbit.propagate(
    ...     j2, None, [7e6, 0, 0], [0, 4e3, 6.4e3], np.arange(0.0, 6e3, 60.0))
    >>> sky = cc.StarCatalogue.random(5000)
    >>> up = cc.celestial.SkyCamera(sky)
    >>> aside = cc.celestial.SkyCamera(sky, boresight=(0.0, -1.0, -1.0))
    >>> found = trade(orbit, {"one": up, "two": [up, aside]}, cc.StarHorizon(), [60.0],
    ...               {"J2": cc.orbit.OrbitDynamics(j2, 1e-9)}, runs=2, skip=3e3)
    >>> bool(found.stars[1] > found.stars[0])
    True
    """
    from celestcore.celestial import CelestialNavigator, Scenario, StarHorizon, monte_carlo

    checked(orbit, "orbit", Trajectory)
    checked(horizon, "horizon", StarHorizon)
    made = _dynamics(dynamics)
    if not isinstance(cameras, Mapping) or not cameras:
        raise InputError("must name at least one", field="cameras", value=cameras)
    navigators = {name: CelestialNavigator(EKF(), d, horizon) for name, d in made.items()}
    ends = {name: f"{name}_smoothed" if smoother else name for name in made}
    wanted, trials = _periods(periods), count(runs, "runs")
    cells = len(cameras) * len(wanted)
    stars: list[float] = []
    bounds: list[float] = []
    scores: list[list[Any]] = []
    for camera in cameras.values():
        for period in wanted:
            scenario = Scenario(
                orbit, camera, horizon, period=float(period), start_sigma=start_sigma
            )
            stars.append(float(np.mean(scenario.stars.counts)))
            bounds.append(posterior_bound(scenario, smoother=smoother).rms(skip)[0])
            found = monte_carlo(
                scenario,
                navigators,
                trials,
                seed,
                smooth=smoother,
                skip=skip,
                threads=threads,
                progress=_heard(progress, len(scores), cells, trials),
            )
            scores.append([found[end].pooled() for end in ends.values()])
    shape = (len(cameras), len(wanted))

    def column(values: list[list[float]]) -> FloatArray:
        return np.array(values).reshape(*shape, len(made))

    return Trade(
        tuple(cameras),
        wanted,
        tuple(made),
        np.array(stars).reshape(shape).mean(axis=1),
        np.array(bounds).reshape(shape),
        column([[s.rms_position for s in row] for row in scores]),
        column([[s.error["rms_position"] for s in row] for row in scores]),
        column([[s.nees for s in row] for row in scores]),
        trials,
        bool(smoother),
    )


def _dynamics(given: Mapping[str, OrbitDynamics] | None) -> dict[str, OrbitDynamics]:
    """Return the dynamics to compare."""
    if given is not None:
        if not isinstance(given, Mapping) or not given:
            raise InputError("must name at least one", field="dynamics", value=given)
        return {name: checked(d, f"dynamics.{name}", OrbitDynamics) for name, d in given.items()}
    forces = {"J2": ForceModel.j2()}
    forces |= {f"{n}x{n}": ForceModel(gravity=n, sun=True, moon=True) for n in (8, 21)}
    return {name: OrbitDynamics(force, PSD[name]) for name, force in forces.items()}


def _periods(periods: Sequence[float]) -> FloatArray:
    found = array(periods, "periods", (None,))
    if not len(found):
        raise InputError("must have at least one", field="periods", value=periods)
    return np.array([number(p, "periods", above=0.0) for p in found])


def _heard(
    progress: Callable[[int, int], object] | None, cell: int, cells: int, trials: int
) -> Callable[[int, int], object] | None:
    """Return a callback for one campaign that tells of all of them."""
    if progress is None:
        return None
    return lambda done, _: progress(cell * trials + done, cells * trials)
