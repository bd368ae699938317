"""Everything that is run: campaigns of all cells, references, single runs; side by side."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import fields
from typing import Any, NamedTuple

import numpy as np

import celestcore as cc
from celestcore._arguments import processors
from celestcore.errors import CelestcoreWarning
from celestcore.gnss import GnssStarScores
from celestcore.reproduce import _gnss_model as model
from celestcore.reproduce import _gnss_paper as paper
from celestcore.reproduce import _gnss_reference as reference
from celestcore.reproduce._gnss_model import SMOOTHED, Cell
from celestcore.reproduce._gnss_traces import observability, traces
from celestcore.reproduce._pool import Job, in_parallel

Progress = Callable[[int, int, str], object]
Scores = dict[str, GnssStarScores]

CHUNK, LONG_CHUNK = 50, 25
"""Runs of one campaign: of 20 minutes, and of three orbits with a gyro."""
OBSERVED = 5
"""Runs that are asked what they saw of the slow error: it hardly differs from run to run."""
EFFORT = {"gyro": 400, "clean": 70, "lfe": 40, "coloured": 40, "outliers": 18}
"""Milliseconds that a run of a cell takes; others 10."""


class Plan(NamedTuple):
    """How much to run."""

    runs: int
    seed: int
    threads: int | None
    draws: int = reference.DRAWS


class _Piece(NamedTuple):
    """One job: what it is, its work, and the job itself."""

    key: Any
    effort: float
    job: Job[Any]


def run(plan: Plan, progress: Progress | None) -> dict[str, Any]:
    """Run everything; the parts of a `Result` by name."""
    pieces = _pieces(plan)
    total = sum(piece.effort for piece in pieces)
    with warnings.catch_warnings():
        # every run of 20 minutes would say that its arc is too short to tell harmonics
        warnings.filterwarnings("ignore", "the fixes span", CelestcoreWarning)
        found = in_parallel(
            [piece.job for piece in pieces],
            processors(plan.threads, alone=True),
            None if progress is None else lambda done, all_: progress(done, all_, "runs"),
            round(total),
        )
        by_key: dict[Any, list[Any]] = {}
        for piece, value in zip(pieces, found, strict=True):
            by_key.setdefault(piece.key, []).append(value)
        observed, slow = by_key["observability"][0]
        drawn = traces(plan.seed, slow)
    return {
        "cells": {cell: _joined(by_key[cell]) for cell in model.CELLS},
        "references": {gps: by_key["reference", gps][0] for gps in paper.GPS},
        "slew": by_key["slew"][0],
        "gyro_star": by_key["gyro_star"][0],
        "antennas": reference.antenna_angles(plan.seed, plan.draws),
        "least_squares": reference.least_squares(plan.seed, plan.draws),
        "observed": observed,
        "traces": drawn,
    }


def _pieces(plan: Plan) -> list[_Piece]:
    """Return all jobs, long and short ones in turn: those hold Python up, these do not."""
    pieces = [piece for cell in model.CELLS for piece in _campaigns(plan, cell)]
    long = [piece for piece in pieces if piece.key.name == "gyro"]
    short = [piece for piece in pieces if piece.key.name != "gyro"]
    short += [_reference(plan, gps) for gps in paper.GPS]
    runs = min(plan.runs, OBSERVED)
    short += [
        _Piece("slew", 15.0 * plan.runs, lambda _: reference.slew(plan.runs, plan.seed)),
        _Piece("gyro_star", 10.0 * plan.runs, lambda _: reference.gyro_star(plan.runs, plan.seed)),
        _Piece(
            "observability",
            80.0 * runs,
            _counted(80.0, lambda told: observability(plan.seed, runs, told)),
        ),
    ]
    out = []
    while long or short:
        if long:
            out.append(long.pop(0))
        # the share of the short ones that goes with each long one
        share = len(short) if not long else max(1, len(short) // (len(long) + 1))
        out += short[:share]
        short = short[share:]
    return out


def _reference(plan: Plan, gps: float) -> _Piece:
    def work(told: Any) -> reference.Reference:
        return reference.reference(gps, plan.runs, plan.seed, told)

    return _Piece(("reference", gps), 40.0 * plan.runs, _counted(40.0, work))


def _counted(effort: float, work: Callable[[Any], Any]) -> Job[Any]:
    """Return a job that is told of each run it has done."""

    def job(heard: Any) -> Any:
        done = 0.0

        def told(runs: int) -> None:
            nonlocal done
            done += effort * runs
            heard(done, 0)

        return work(told)

    return job


def _campaigns(plan: Plan, cell: Cell) -> list[_Piece]:
    """Return the campaigns of one cell, a part of the runs each."""
    size = LONG_CHUNK if cell.name == "gyro" else CHUNK
    effort = EFFORT.get(cell.name, 10)
    out = []
    for first in range(0, plan.runs, size):
        runs = min(size, plan.runs - first)
        job = _campaign(plan, cell, first, runs, effort)
        out.append(_Piece(cell, effort * runs, job))
    return out


def _campaign(plan: Plan, cell: Cell, first: int, runs: int, effort: float) -> Job[Scores]:
    def job(heard: Any) -> Scores:
        found = cc.gnss.monte_carlo(
            model.scenario(cell),
            model.navigators(cell),
            trials=runs,
            seed=plan.seed,
            first=first,
            smooth=SMOOTHED.get(cell.name, False),
            skip=model.SKIP,
            threads=1,
            chunk=1,
            progress=lambda done, _: heard(effort * done, 0),
        )
        return dict(found)

    return job


def _joined(parts: list[Scores]) -> Scores:
    """Put the runs of several campaigns one after the other."""
    if len(parts) == 1:
        return parts[0]
    names = [f.name for f in fields(GnssStarScores) if f.name != "failures"]
    return {
        key: GnssStarScores(
            **{name: np.concatenate([getattr(p[key], name) for p in parts]) for name in names},
            failures={k: v for part in parts for k, v in part[key].failures.items()},
        )
        for key in parts[0]
    }
