"""Blocks R1 and R2 against the covariance of a filter that is told the wrong noise."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.reproduce import _blocks, _model, star_gyro
from celestcore.reproduce._theory import theory
from celestcore.reproduce.star_gyro import PAPER_EKF, PAPER_UKF
from celestcore.units import ARCSEC, ARCSEC_PER_S
from simulate import FloatArray, discretise


def expected(cell: _model.Cell, gyro: float, walk: float) -> FloatArray:
    """Return the figures that a mistuned filter has on average: its gain on the true noise."""
    rate, arcsec = np.array([0.0, -_model.RATE, 0.0]), np.repeat([ARCSEC, ARCSEC_PER_S], 3)
    told = _model.angle_random_walk(gyro), walk / 3.0 * ARCSEC_PER_S
    f, q_told = discretise(rate, 0.1, *told)
    _, q_true = discretise(rate, 0.1, _model.angle_random_walk(cell.gyro), _model.BIAS_WALK)
    unit = np.outer(arcsec, arcsec)
    f, q_told, q_true = f / arcsec[:, None] * arcsec, q_told / unit, q_true / unit
    r_told = (cell.star / 3.0) ** 2 * np.eye(3)
    r_true = _model.star_covariance(cell.star) / ARCSEC**2
    p, e = np.zeros((6, 6)), np.zeros((6, 6))
    p[:3, :3], e[:3, :3] = r_told, r_true
    p[3:, 3:] = e[3:, 3:] = 0.01**2 * np.eye(3)
    h = np.eye(3, 6)
    total, count = np.zeros(3), 0
    for k in range(1, round(_model.DURATION / 0.2)):
        for _ in range(2):
            p, e = f @ p @ f.T + q_told, f @ e @ f.T + q_true
        gain = np.linalg.solve(p[:3, :3] + r_told, p[:3]).T
        left = np.eye(6) - gain @ h
        p = left @ p @ left.T + gain @ r_told @ gain.T
        e = left @ e @ left.T + gain @ r_true @ gain.T
        if 0.2 * k >= _model.SKIP:
            total, count = total + np.diag(e)[:3], count + 1
    return _model.figures(np.sqrt(total / count) * ARCSEC)


@pytest.mark.parametrize("star", [5.0, 1.0])
def test_fitted_blocks_are_as_large_as_theory_says(star: float) -> None:
    """Gyros with errors that die out fast, so that 6 orbits tell the figures to 1 %."""
    cell = _model.Cell(star, 2.4, 0)
    truth = cc.simulate.earth_pointing(_model.DURATION)
    found = _blocks._campaign(truth, cell, True, (6, 5), lambda done, total: None)
    for name, gyro, walk in (
        ("r1", _model.R1_GYRO, 0.0),
        ("r2", _model.R2_GYRO, _model.R2_WALK),
    ):
        figures = np.sqrt(np.mean(_model.figures(found[name]["rms"]) ** 2, axis=0))
        np.testing.assert_allclose(figures, expected(cell, gyro, walk), rtol=0.03)
        swapped = _model.figures(found[name + "_swapped"]["rms"])
        np.testing.assert_allclose(_model.figures(found[name]["rms"]), swapped, rtol=1e-6)


def test_all_cells_with_the_extended_filter() -> None:
    """R1, R2 and T of section S in all 36 cells, as `star_gyro.run` does them, with 8 orbits."""
    truth, orbits, ekf = _blocks._truth(), 8, cc.EKF()
    found: dict[str, list[FloatArray]] = {"r1": [], "r2": [], "mekf": []}
    nees = []
    for cell in _model.cells():
        fitted = {
            "r1": _model.fitted(cell, ekf, _model.R1_GYRO, 0.0),
            "r2": _model.fitted(cell, ekf, _model.R2_GYRO, _model.R2_WALK),
        }
        result = {}
        for told, bias in (
            (fitted, _model.FIT_BIAS_SIGMA),
            ({"mekf": _model.tuned(cell, ekf)}, _model.BIAS_SIGMA),
        ):
            result |= cc.monte_carlo(
                _blocks._scenario(truth, cell.star, cell.gyro, bias),
                told,
                trials=orbits,
                seed=31,
                first=cell.index * orbits,
                skip=_model.SKIP,
                sigma0=(1.0, bias),
            )
        for name, rows in found.items():
            rows.append(np.sqrt(np.mean(_model.figures(result[name].rms) ** 2, axis=0)))
        nees.append(result["mekf"].nees_attitude.mean() / 3.0)
    figures = {name: np.reshape(rows, PAPER_UKF.shape) for name, rows in found.items()}
    within = {
        "r1": np.sum(np.abs(figures["r1"] / PAPER_UKF - 1.0) < 0.1),
        "r2": np.sum(np.abs(figures["r2"] / PAPER_EKF - 1.0) < 0.1),
    }
    bound = theory(_model.cells()).filter.reshape(PAPER_UKF.shape)
    ratio = figures["mekf"] / bound
    print(within, ratio.mean(), np.mean(nees), np.sum(figures["mekf"] < PAPER_UKF))
    assert min(within.values()) >= 100
    assert ratio.mean() == pytest.approx(1.0, abs=0.01)
    assert np.mean(nees) == pytest.approx(1.0, abs=0.03)
    assert 82 <= np.sum(figures["mekf"] < PAPER_UKF) <= 90  # about 86


@pytest.mark.long
def test_every_target_is_met() -> None:
    result = star_gyro.run(seed=987)
    missed = [t for t in result.targets() if not t.met]
    assert missed == []
    assert result.elapsed_s < 180.0
