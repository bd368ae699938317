"""Pictures: what is drawn, how much of it, and how fast."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from celestcore import plot
from celestcore._curves import euler_321, extremes, time_axis, wrapped
from celestcore.analysis import WithheldDrift
from celestcore.errors import InputError
from celestcore.solution import Solution

MakeSolution = Callable[..., Solution]

pytest.importorskip("matplotlib")


def test_euler_angles_agree_with_scipy() -> None:
    rotation = pytest.importorskip("scipy.spatial.transform").Rotation
    random = rotation.random(200, rng=np.random.default_rng(3))
    q = np.roll(random.as_quat(), 1, axis=-1)
    np.testing.assert_allclose(euler_321(q), random.as_euler("ZYX"), atol=1e-12)


@pytest.mark.parametrize("n", [0, 1, 2, 17, 2000, 2001, 99_999])
def test_extremes_keep_ends_and_extremes(n: int) -> None:
    y = np.random.default_rng(n).standard_normal(n)
    rows = extremes(y)
    assert len(rows) <= 2100
    assert np.all(np.diff(rows) > 0)
    if n:
        assert {0, n - 1, int(y.argmin()), int(y.argmax())} <= set(rows.tolist())


def test_a_wrapped_line_is_broken_where_it_jumps() -> None:
    t, angle = wrapped(np.arange(4.0), np.array([170.0, 179.0, 181.0, 190.0]))
    np.testing.assert_array_equal(angle, [170.0, 179.0, np.nan, -179.0, -170.0])
    assert np.isnan(t[2])


def test_time_axis_chooses_unit_and_start() -> None:
    t = np.arange(100.0)
    assert time_axis(t, "2026-01-01").label == "time since 2026-01-01 [s]"
    assert time_axis(100.0 * t, None).label == "time since the start [h]"
    late = time_axis(5e8 + t, None)
    assert late.label == "time since t = 500000000 s [s]"
    assert late(5e8 + t)[0] == 0.0
    assert time_axis(5e8 + t, "2000-01-01").label == "time since 2000-01-01 + 500000000 s [s]"


def test_the_figure_names_units_and_marks_what_matters(solution: Solution) -> None:
    axes = solution.plot().axes
    assert len(axes) == 1 + 3 + 1 + 3 + 1
    labels = [ax.get_ylabel() for ax in axes]
    assert labels[0] == "angle [deg]"
    assert labels[1] == "bias [deg/h]"
    assert "1 sigma [arcsec]" in labels
    assert "innovation [arcsec]" in labels
    assert axes[-1].get_xlabel() == "time since 2026-01-01T00:00:00 [min]"
    assert "3-2-1 Euler" in axes[0].get_title(loc="left")
    words = {text.get_text() for text in axes[-1].get_legend().get_texts()}
    rejected = solution.counts["rejected"]
    assert {"95 % chi-square bounds", f"rejected ({rejected})", "gyro gap (1)"} <= words


def test_the_attitude_names_only_a_frame_that_was_given(make_solution: MakeSolution) -> None:
    for frames, name in (({}, "the inertial frame"), ({"inertial": "ICRF"}, "ICRF")):
        title = make_solution(100, frames=frames).plot(("attitude",)).axes[0].get_title(loc="left")
        assert title.endswith(f"body relative to {name}")


def test_nis_bounds_are_the_chi_square_quantiles(solution: Solution) -> None:
    chi2 = pytest.importorskip("scipy.stats").chi2
    assert plot.chi2_bounds(3) == pytest.approx(chi2.ppf([0.025, 0.975], 3), rel=1e-10)
    assert plot.chi2_bounds(2, 0.99) == pytest.approx(chi2.ppf([0.005, 0.995], 2), rel=1e-10)


def test_one_row_a_sensor(make_solution: MakeSolution) -> None:
    figure = make_solution(600, sensors=3).plot(("innovation", "nis"))
    assert len(figure.axes) == (3 + 3 + 2) + 3


def test_drift_figure(drift: WithheldDrift) -> None:
    (ax,) = plot.drift_figure(drift, "2026-01-01").axes
    assert ax.get_ylabel() == "drift [arcsec]"
    assert "600 s" in ax.get_title(loc="left")
    assert {len(line.get_xdata()) for line in ax.get_lines()} == {40}


def test_hard_solutions_still_plot(make_solution: MakeSolution) -> None:
    sol = make_solution(400)
    none = sol[:0.5]
    assert len(none) == 1
    assert len(none.measurement_t) == 0
    none.plot().canvas.draw()
    all_rejected = make_solution(400, accepted=np.zeros(200, dtype=bool))
    all_rejected.plot().canvas.draw()
    make_solution(400, nis=np.full(200, np.nan), bias=np.zeros((400, 3))).plot().canvas.draw()
    make_solution(400, sigma=np.zeros((400, 6))).plot().canvas.draw()


def test_unknown_panels_and_empty_solutions_are_refused(solution: Solution) -> None:
    with pytest.raises(InputError, match="choose from attitude, bias"):
        solution.plot(("attitude", "orbit"))
    with pytest.raises(InputError, match="empty"):
        solution[1e9:].plot()


def test_a_million_rows_plot_fast_and_small(make_solution: MakeSolution, tmp_path: Path) -> None:
    sol = make_solution(1_000_000)
    make_solution(100).plot().canvas.draw()
    start = time.perf_counter()
    plot.save(sol.plot(), tmp_path / "a.png")
    assert time.perf_counter() - start < 6.0, "2 s on an idle machine"
    assert (tmp_path / "a.png").stat().st_size < 1_000_000
    plot.save(sol.plot(("attitude", "bias", "sigma")), tmp_path / "a.svg")
    assert (tmp_path / "a.svg").stat().st_size < 1_500_000


def test_plotting_needs_no_pyplot() -> None:
    code = "import sys, celestcore.plot; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True)
