"""The workbench of the orbit experiment: truth, sky, scenarios, filters, and campaigns of them."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cached_property
from typing import Any, NamedTuple

import celestcore as cc
from celestcore.reproduce import _orbit_model as model
from celestcore.reproduce import _orbit_paper as paper
from celestcore.reproduce._orbit_model import SMOOTHED, Cell
from celestcore.reproduce._orbit_scores import Scores

Progress = Callable[[int, int, str], object]

OPTIONS: dict[str, Any] = {"ekf_gated": {"gate": 0.9999}, "huber": {"huber": 1.345}}
"""A good angle passes with this probability; beyond so many sigma it counts less."""
T_DOF = 3.0


class Plan(NamedTuple):
    """How much to run."""

    runs: int
    long_runs: int
    start_runs: int
    seed: int
    threads: int | None


class Bench:
    """The true orbit, the sky and the scenarios that are made of them; and what has been done."""

    def __init__(self, plan: Plan, progress: Progress | None, total: float) -> None:
        self.plan = plan
        self.progress = progress
        self.total = total
        self.done = 0.0

    @cached_property
    def orbit(self) -> cc.orbit.Trajectory:
        """The truth at every 3 s."""
        return model.true_orbit()

    @cached_property
    def camera(self) -> Any:
        """The star camera, looking at the zenith."""
        return cc.celestial.SkyCamera(
            model.catalogue(),
            model.FIELD,
            brightest=model.BRIGHTEST,
            earth_margin=model.MARGIN,
        )

    def scenario(self, cell: Cell) -> Any:
        """Return what is simulated in a cell."""
        return cc.celestial.Scenario(
            self.orbit,
            self.camera,
            horizon(cell),
            period=cell.period,
            start_sigma=cell.start,
            outliers=cell.outliers,
        )

    def campaign(
        self, cell: Cell, navigators: dict[str, Any], what: str, **options: Any
    ) -> dict[str, Scores]:
        """Run many trials of a cell through filters; smoothed ones by their own names."""
        options = {"trials": self.plan.runs, "skip": model.SKIP, **options}
        before, share = self.done, effort(cell) * len(navigators)

        def heard(done: int, _: int) -> None:
            self.told(before + share * done, what)

        found = cc.celestial.monte_carlo(
            self.scenario(cell),
            navigators,
            seed=self.plan.seed,
            threads=options.pop("threads", self.plan.threads),
            progress=heard,
            **options,
        )
        self.told(before + share * options["trials"], what)
        ends = {f"{name}_smoothed": smoothed for name, smoothed in SMOOTHED.items()}
        return {ends.get(name, name): Scores.of(scores) for name, scores in found.items()}

    def told(self, done: float, what: str) -> None:
        """Tell how far the work is; raises on Ctrl-C."""
        self.done = done
        if self.progress is not None:
            self.progress(round(done), round(self.total), what)


def effort(cell: Cell) -> float:
    """Return the work of one filter in one trial: epochs."""
    return model.DURATION / cell.period


def horizon(cell: Cell, edge: float = 0.05, width: float = 1.0) -> Any:
    """Return the noise of a cell: what is simulated, and what the filters are told.

    Parameters
    ----------
    cell : Cell
    edge : float
        Softness of the edges of uniform noise.
    width : float
        Multiplies all sigmas.
    """
    return cc.StarHorizon(
        width * model.SIGMA_STAR,
        width * model.SIGMA_NADIR,
        correlated=cell.noise == "B",
        distribution=cell.distribution,
        dof=T_DOF,
        edge=edge,
    )


def navigator(name: str, cell: Cell, robust: bool = False) -> Any:
    """Return a filter by its name in the JSON.

    Parameters
    ----------
    name : str
        With "_apart" after it, angles are used one by one instead of combined to a direction.
    cell : Cell
    robust : bool
        Whether the filters that use a likelihood take the noise for Student's t.
    """
    name, apart, _ = name.partition("_apart")
    gravity = name.rpartition("_")[2] if name.endswith(("8x8", "21x21")) else "j2"
    psd = model.OTHER_PSD.get(name, model.ACCEL_PSD[gravity])
    if cell.distribution == "uniform":
        psd = model.UNIFORM_PSD.get(name, psd)
    integrator, edge = "rk4", model.EDGES.get(name.split("_")[0], 0.05)
    if name == "ekf_taylor":
        psd, integrator = model.TAYLOR_PSD[cell.period], "taylor"
    dynamics = cc.orbit.OrbitDynamics(model.force(gravity), psd, integrator=integrator)
    told = cell._replace(distribution="student_t") if robust else cell
    return cc.CelestialNavigator(
        _filter(name), dynamics, horizon(told, edge), combine=not apart, **OPTIONS.get(name, {})
    )


def _filter(name: str) -> Any:
    kind = name.split("_")[0]
    if kind == "upf":
        return cc.UPF(particles=paper.PARTICLES, form=model.PARTICLE_FORMS[name])
    if name == "ukf_scaled":
        return cc.UKF(alpha=1e-3, kappa=0.0)
    if kind == "bootstrap":
        return cc.BootstrapPF()
    return {"ukf": cc.UKF, "srukf": cc.SRUKF, "score": cc.ScoreEKF}.get(kind, cc.EKF)()


def navigators(names: Iterable[str], cell: Cell, robust: bool = False) -> dict[str, Any]:
    """Return several filters for a cell."""
    return {name: navigator(name, cell, robust) for name in names}
