"""Requirements: what is found reaches the target to the digit, and pictures say it plainly."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import (
    allan_deviation,
    fit_allan,
    plot_allan,
    plot_requirements,
    required_gyro,
    required_star,
    steady_state,
)
from celestcore.analysis.requirements import attained, judged
from celestcore.errors import InputError

ARCSEC = cc.ARCSEC
NOISE = np.array([[4.0, 1.0, -0.5], [1.0, 9.0, 2.0], [-0.5, 2.0, 25.0]]) * 1e-10
RATE = (1e-3, 0.02, 0.0)
SIGMAS = {
    "filter": "sigma_filter",
    "before": "sigma_before",
    "between": "sigma_between",
    "smoother": "sigma_smoother",
}


@pytest.mark.parametrize("at", SIGMAS)
@pytest.mark.parametrize("axis", ["worst", "total", "x", "y", "z"])
def test_the_gyro_that_is_found_reaches_the_target(axis: str, at: str) -> None:
    target = 6 * ARCSEC
    arw = required_gyro(target, NOISE, 0.1, 0.5, rrw=1e-8, rate=RATE, axis=axis, level=2.0, at=at)
    bound = steady_state(cc.Gyro(arw=arw, rrw=1e-8), NOISE, 0.1, 0.5, RATE)
    sigma = getattr(bound, SIGMAS[at])[:3]
    reached = {"worst": sigma.max(), "total": np.linalg.norm(sigma)}
    reached.update(zip("xyz", sigma, strict=True))
    assert 2.0 * reached[axis] == pytest.approx(target, rel=1e-6)


@pytest.mark.parametrize("at", SIGMAS)
@pytest.mark.parametrize("rrw", [0.0, 1e-9])
def test_the_camera_that_is_found_reaches_the_target(at: str, rrw: float) -> None:
    gyro = cc.Gyro(arw=1e-6, rrw=rrw)
    factor = required_star(1 * ARCSEC, gyro, 0.1, 0.5, star=NOISE, rate=RATE, at=at)
    bound = steady_state(gyro, NOISE * factor**2, 0.1, 0.5, RATE)
    assert getattr(bound, SIGMAS[at])[:3].max() == pytest.approx(1 * ARCSEC, rel=1e-6)


def test_gyro_and_camera_ask_the_same_question() -> None:
    sigma = 7 * ARCSEC
    arw = required_gyro(2 * ARCSEC, sigma, 0.1, 1.0, rrw=1e-9)
    back = required_star(2 * ARCSEC, cc.Gyro(arw=arw, rrw=1e-9), 0.1, 1.0)
    assert back == pytest.approx(sigma, rel=1e-6)


def test_a_target_of_three_angles() -> None:
    wanted = np.array([2.0, 3.0, 4.0]) * ARCSEC
    arw = required_gyro(wanted, NOISE, 0.1, 0.5)
    sigma = steady_state(cc.Gyro(arw=arw), NOISE, 0.1, 0.5).sigma_filter[:3]
    assert np.max(sigma / wanted) == pytest.approx(1.0, rel=1e-6)


def test_any_gyro_will_do_if_fixes_alone_reach_the_target() -> None:
    assert required_gyro(5 * ARCSEC, 4 * ARCSEC, 0.1, 0.5) == np.inf
    assert np.isfinite(required_gyro(5 * ARCSEC, 4 * ARCSEC, 0.1, 0.5, at="before"))


def test_what_cannot_be_reached_says_what_can() -> None:
    with pytest.raises(InputError, match=r"arcsec is attained at best") as caught:
        required_gyro(0.1 * ARCSEC, 10 * ARCSEC, 0.1, 1.0, rrw=1e-6)
    best = steady_state(cc.Gyro(arw=1e-12, rrw=1e-6), 10 * ARCSEC, 0.1, 1.0).sigma_filter[0]
    assert f"{best / ARCSEC:.4g} arcsec" in str(caught.value)
    with pytest.raises(InputError, match="no camera reaches it"):
        required_star(0.1 * ARCSEC, cc.Gyro(arw=1e-5, rrw=1e-7), 0.1, 1.0, at="before")
    with pytest.raises(InputError, match="times the target"):
        required_gyro([1e-8, 1e-8, 1e-8], 10 * ARCSEC, 0.1, 1.0, rrw=1e-6)


@pytest.mark.parametrize("at", SIGMAS)
def test_many_at_once_are_each_alone(at: str) -> None:
    arw = np.array([[1e-7, 1e-6, 1e-5], [2e-7, 3e-6, 4e-5]])
    noise = NOISE * np.array([1e-2, 1.0])[:, None, None, None]
    noise = np.broadcast_to(noise, (2, 3, 3, 3))
    found = attained(arw, 1e-8, noise, 0.1, 0.5, np.array(RATE), at)
    for i in range(2):
        for j in range(3):
            bound = steady_state(cc.Gyro(arw[i, j], 1e-8), noise[i, j], 0.1, 0.5, RATE)
            np.testing.assert_allclose(found[i, j], getattr(bound, SIGMAS[at])[:3], rtol=1e-9)
    assert judged(found, "z").shape == (2, 3)


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"target": -1.0}, "target"),
        ({"target": [1.0, 2.0]}, "target"),
        ({"target": [1e-5, 1e-5, 1e-5], "axis": "total"}, "target"),
        ({"star": 0.0}, "star"),
        ({"gyro_dt": 0.0}, "gyro_dt"),
        ({"star_dt": -1.0}, "star_dt"),
        ({"rrw": -1.0}, "rrw"),
        ({"rate": [1.0, 2.0]}, "rate"),
        ({"axis": "w"}, "axis"),
        ({"level": 0.0}, "level"),
        ({"at": "after"}, "at"),
    ],
)
def test_bad_questions_are_named(changes: dict[str, object], field: str) -> None:
    arguments = {"target": 1e-5, "star": 1e-5, "gyro_dt": 0.1, "star_dt": 0.5, **changes}
    with pytest.raises(InputError) as caught:
        required_gyro(**arguments)  # type: ignore[arg-type]
    assert caught.value.field.startswith(field)


class TestPictures:
    SPAN = (1e-4 * cc.DEG_PER_SQRT_HOUR, 1e-1 * cc.DEG_PER_SQRT_HOUR)

    @pytest.fixture(autouse=True)
    def _needs_matplotlib(self) -> None:
        pytest.importorskip("matplotlib")

    def test_the_target_line_is_the_required_gyro(self) -> None:
        target = 2 * ARCSEC
        fig = plot_requirements(self.SPAN, (1 * ARCSEC, 60 * ARCSEC), 0.1, 1.0, target=target)
        ax = fig.axes[0]
        thick = [c for c in ax.collections if np.any(np.asarray(c.get_linewidth()) > 2.0)]
        points = np.concatenate([p.vertices for p in thick[0].get_paths()])
        for sigma in (5.0, 20.0):
            at = points[np.argmin(np.abs(points[:, 1] / sigma - 1.0))]
            arw = required_gyro(target, at[1] * ARCSEC, 0.1, 1.0)
            assert at[0] * cc.DEG_PER_SQRT_HOUR == pytest.approx(arw, rel=0.02)
        assert "reaches 2 arcsec" in ax.get_title(loc="right")
        assert ax.get_xlabel() == "gyro angle random walk [deg/√h]"
        assert ax.get_ylabel() == "star camera [arcsec, 1 sigma]"

    def test_marks_levels_and_words(self) -> None:
        fig = plot_requirements(
            self.SPAN,
            (1 * ARCSEC, 60 * ARCSEC),
            0.1,
            1.0,
            star=NOISE / NOISE.max(),
            rrw=1e-8,
            rate=RATE,
            axis="total",
            level=3,
            at="smoother",
            mark={"ours": (1e-6, 5 * ARCSEC)},
        )
        fig.canvas.draw()
        ax = fig.axes[0]
        assert "ours" in {text.get_text() for text in ax.texts}
        assert (
            fig.get_suptitle() == "Attitude error [arcsec], 3 sigma, smoothed, total of three axes"
        )
        assert ax.get_title(loc="right") == ""
        assert "rate random walk" in ax.get_title(loc="left")

    @pytest.mark.parametrize(("target", "words"), [(1e-9, "nothing here"), (1.0, "shaded")])
    def test_targets_off_the_picture(self, target: float, words: str) -> None:
        fig = plot_requirements(self.SPAN, (1e-6, 1e-4), 0.1, 1.0, target=target, axis="x")
        assert words in fig.axes[0].get_title(loc="right")

    def test_bad_pictures_are_named(self) -> None:
        for arw, sigma, field in (
            ((1e-5, 1e-6), (1e-6, 1e-5), "arw"),
            ((1e-6, 1e-5), (0.0, 1e-5), "sigma"),
            ((1e-6, 1e-5, 1e-4), (1e-6, 1e-5), "arw"),
        ):
            with pytest.raises(InputError, match=field):
                plot_requirements(arw, sigma, 0.1, 1.0)

    @pytest.mark.parametrize("axes", [1, 2, 3])
    def test_allan_with_its_fit(self, axes: int) -> None:
        w = np.random.default_rng(1).standard_normal((2000, axes)) * 1e-6
        curve = allan_deviation(w, 0.1)
        fig = plot_allan(curve, fit_allan(curve))
        fig.canvas.draw()
        ax = fig.axes[0]
        assert ax.get_ylabel() == "Allan deviation [deg/h]"
        assert "deg/√h" in ax.get_title(loc="left")
        assert len(ax.get_legend().get_texts()) == axes
        assert "fit" not in plot_allan(curve).axes[0].get_title(loc="left")
