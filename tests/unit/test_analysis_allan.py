"""Allan deviation: by hand, against its laws, and fitted noise against what was simulated."""

from __future__ import annotations

import time

import celestcore as cc
import numpy as np
import pytest
from celestcore.analysis import AllanDeviation, AllanFit, allan_deviation, fit_allan
from celestcore.analysis._allan_law import scatter, slopes
from celestcore.errors import InputError
from numpy.typing import NDArray
from scipy.stats import kstest

Array = NDArray[np.float64]


def gyro(rng: np.random.Generator, n: int, dt: float, arw: float, rrw: float, axes: int) -> Array:
    """Return readings (n, axes): mean rates over each step, of a bias that walks on within it."""
    step, inner = np.sqrt([dt, dt / 12.0])[:, None, None] * rng.standard_normal((2, n, axes)) * rrw
    bias = np.cumsum(step, axis=0) - 0.5 * step + inner
    return np.asarray(bias + arw / np.sqrt(dt) * rng.standard_normal((n, axes)))


def flicker(rng: np.random.Generator, n: int, dt: float, size: float, axes: int) -> Array:
    """Return noise of power density ``size^2 / (2 pi f)``, both sides, cut from a longer circle."""
    long = 8 * n
    f = np.fft.rfftfreq(long, dt)[1:, None]
    shape = (len(f), axes)
    white = rng.standard_normal(shape) + 1j * rng.standard_normal(shape)
    spectrum = white * np.sqrt(0.5 * long / dt * size**2 / (2.0 * np.pi * f))
    return np.asarray(np.fft.irfft(np.vstack([np.zeros((1, axes)), spectrum]), long, axis=0)[:n])


def test_by_hand() -> None:
    """The textbook form: means of neighbouring windows, at every start."""
    w, dt, m = np.random.default_rng(1).standard_normal(50), 0.5, 4
    mean = np.array([w[k : k + m].mean() for k in range(50 - m + 1)])
    known = np.sqrt(0.5 * np.mean((mean[m:] - mean[:-m]) ** 2))
    curve = allan_deviation(w, dt, [m * dt])
    assert curve.tau.tolist() == [2.0]
    assert curve.deviation[0, 0] == pytest.approx(known, rel=1e-12)


def test_a_constant_rate_and_a_large_one_do_no_harm() -> None:
    w = 1e-6 * np.random.default_rng(2).standard_normal((5000, 3))
    turn = np.array([0.1, -2.0, 0.0])
    here, there = allan_deviation(w, 0.1), allan_deviation(w + turn, 0.1)
    np.testing.assert_allclose(there.deviation, here.deviation, rtol=1e-8)


def test_a_ramp_has_its_slope() -> None:
    curve = allan_deviation(3e-4 * np.arange(1000.0), 1.0)
    np.testing.assert_allclose(curve.deviation[:, 0], 3e-4 * curve.tau / np.sqrt(2), rtol=1e-9)


def test_default_times_and_a_log() -> None:
    t = 7.0 + 0.1 * np.arange(4001)
    w = np.random.default_rng(3).standard_normal((4001, 3)) * 1e-5
    curve = allan_deviation(cc.SensorLog(gyro=(t, w)))
    assert curve.tau[0] == pytest.approx(0.1)
    assert 70.0 < curve.tau[-1] <= 100.0
    np.testing.assert_array_equal(curve.deviation, allan_deviation(w, t).deviation)
    np.testing.assert_allclose(allan_deviation(w, 0.1).deviation, curve.deviation, rtol=1e-9)


@pytest.mark.parametrize(
    ("term", "make"),
    [
        (0, lambda rng: gyro(rng, 4000, 0.5, 1e-5, 0.0, 400)),
        (1, lambda rng: gyro(rng, 4000, 0.5, 0.0, 1e-5, 400)),
        (2, lambda rng: flicker(rng, 4000, 0.5, 1e-5, 400)),
        (3, lambda rng: 1e-5 * np.diff(rng.standard_normal((4001, 400)), axis=0) / 0.5),
    ],
    ids=["white", "walk", "flicker", "quantisation"],
)
def test_mean_and_scatter_of_each_noise_follow_its_law(term: int, make: object) -> None:
    """400 logs; the scatter of their Allan variances together, correlations included."""
    m = np.array([8, 16, 32, 128, 1000])
    curve = allan_deviation(make(np.random.default_rng(4)), 0.5, 0.5 * m)  # type: ignore[operator]
    variance = curve.deviation**2
    mean = slopes(curve.tau)[:, term] * 1e-10
    spread = scatter(m, 4000, 0.5)[term, term] * 1e-20
    z = (variance.mean(axis=1) - mean) / np.sqrt(np.diag(spread) / 400)
    rtol = 0.01 if term == 2 else 0.0  # the sampled flicker has no power above half the rate
    assert np.all(np.abs(z) < 4.0 + rtol * mean / np.sqrt(np.diag(spread) / 400))
    found = np.cov(variance)
    size = np.sqrt(np.outer(np.diag(spread), np.diag(spread)))
    # the standard error of a covariance of 400 draws with the tails of few degrees of freedom
    np.testing.assert_allclose(found / size, spread / size, atol=0.35)
    np.testing.assert_allclose(np.diag(found)[:4] / np.diag(spread)[:4], 1.0, atol=0.3)


def test_long_sums_as_integrals_agree_with_the_sums(monkeypatch: pytest.MonkeyPatch) -> None:
    m = np.array([100, 300, 1000])
    exact = scatter(m, 5000, 0.1)[:3, :3]
    monkeypatch.setattr("celestcore.analysis._allan_law._EXACT", 0)
    np.testing.assert_allclose(scatter(m, 5000, 0.1)[:3, :3], exact, rtol=2e-3)


@pytest.mark.parametrize(
    ("dt", "arw", "rrw"), [(1.0, 1e-5, 2e-7), (0.1, 1e-5, 1e-6), (0.1, 3e-7, 1e-9)]
)
def test_the_fit_finds_the_noise_within_its_errors(dt: float, arw: float, rrw: float) -> None:
    """120 axes of 10 000 samples; errors in units of the uncertainty are standard normal."""
    w = gyro(np.random.default_rng(5), 10_000, dt, arw, rrw, 120)
    fit = fit_allan(allan_deviation(w, dt), ["arw", "rrw"])
    seen = fit.rrw > 3 * fit.sigma["rrw"]
    z = (fit.arw - arw) / fit.sigma["arw"]
    assert abs(z.mean()) < 4 / np.sqrt(120)
    assert 0.75 < z.std() < 1.25
    z = (fit.rrw**2 - rrw**2) / np.where(seen, 2 * fit.rrw * fit.sigma["rrw"], np.inf)
    assert np.all(np.abs(z) < 5)
    if seen.all():
        assert abs(np.mean((fit.rrw - rrw) / fit.sigma["rrw"])) < 0.5
        assert 0.75 < np.std((fit.rrw - rrw) / fit.sigma["rrw"]) < 1.3
    assert np.median(fit.p_value) == pytest.approx(0.5, abs=0.15)
    assert np.mean(fit.p_value < 0.01) < 0.05


def test_white_noise_alone_has_no_walk() -> None:
    w = gyro(np.random.default_rng(6), 10_000, 0.1, 1e-5, 0.0, 60)
    fit = fit_allan(allan_deviation(w, 0.1))
    assert np.mean(fit.rrw < 3 * fit.sigma["rrw"]) > 0.9
    zero = fit.rrw == 0.0
    assert 0.3 < zero.mean() < 0.9
    assert np.all(fit.sigma["rrw"][zero] > 0.0)
    assert np.all(fit.bias_instability == 0.0)
    assert np.all(np.isnan(fit.sigma["bias_instability"]))


def test_flicker_is_seen_only_where_it_is() -> None:
    rng = np.random.default_rng(7)
    quiet = gyro(rng, 20_000, 0.1, 1e-5, 1e-7, 20)
    with_flicker = quiet + flicker(rng, 20_000, 0.1, 1e-5, 20)
    assert np.all(fit_allan(allan_deviation(quiet, 0.1)).bias_instability == 0.0)
    fit = fit_allan(allan_deviation(with_flicker, 0.1))
    found = fit.bias_instability
    assert np.all(found > 0.0)
    assert np.mean(found) == pytest.approx(1e-5, rel=0.1)
    assert np.mean(np.abs(found - 1e-5) < 3 * fit.sigma["bias_instability"]) > 0.8


def test_quantisation_is_seen() -> None:
    rng = np.random.default_rng(8)
    turn = 1.2345e-3  # several counts a step, or the error is not white
    angle = np.cumsum((gyro(rng, 20_000, 0.01, 1e-6, 0.0, 10) + turn) * 0.01, axis=0)
    count = 3e-6
    read = np.diff(np.round(angle / count) * count, axis=0) / 0.01
    fit = fit_allan(allan_deviation(read, 0.01))
    np.testing.assert_allclose(fit.quantisation, count / np.sqrt(12), rtol=0.1)
    np.testing.assert_allclose(fit.arw, 1e-6, rtol=0.2)


def test_what_no_term_explains_is_refuted() -> None:
    t = 0.1 * np.arange(20_000)
    w = gyro(np.random.default_rng(9), 20_000, 0.1, 1e-5, 1e-8, 1)[:, 0] + 1e-5 * np.sin(t / 3)
    assert fit_allan(allan_deviation(w, 0.1)).p_value[0] < 1e-6


def test_the_fit_as_a_gyro_and_a_curve() -> None:
    w = gyro(np.random.default_rng(10), 10_000, 0.1, 1e-5, 1e-6, 3)
    curve = allan_deviation(w, 0.1)
    fit = fit_allan(curve)
    sensor = fit.gyro(sampling="integrated")
    assert sensor.arw == pytest.approx(1e-5, rel=0.05)
    assert sensor.rrw == pytest.approx(1e-6, rel=0.4)
    assert sensor.sampling == "integrated"
    off = (fit.deviation(curve.tau) - curve.deviation) / curve.sigma
    assert np.all(np.abs(off) < 5)


def test_close_times_are_thinned() -> None:
    w = gyro(np.random.default_rng(11), 5000, 0.1, 1e-5, 1e-6, 1)
    fit = fit_allan(allan_deviation(w, 0.1, 0.1 * np.arange(1.0, 1000.0)), ["arw", "rrw"])
    assert fit.arw[0] == pytest.approx(1e-5, rel=0.1)


def test_a_day_at_ten_hertz_takes_seconds() -> None:
    w = np.random.default_rng(12).standard_normal((864_000, 3)) * 1e-5
    begin = time.perf_counter()
    fit_allan(allan_deviation(w, 0.1))
    assert time.perf_counter() - begin < 10.0


def test_p_values_of_a_right_model_are_uniform() -> None:
    w = gyro(np.random.default_rng(13), 4000, 1.0, 1e-5, 1e-6, 100)
    fit = fit_allan(allan_deviation(w, 1.0), ["arw", "rrw"])
    assert kstest(fit.p_value, "uniform").pvalue > 1e-3


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((np.ones(15), 1.0), "at least 16"),
        ((np.ones((4, 5, 6)), 1.0), "rate"),
        ((np.ones(20),), "dt: is needed"),
        ((np.ones(20), 0.0), "dt"),
        ((np.ones(20), np.arange(19.0)), "dt"),
        ((np.ones(20), np.concatenate([np.arange(10.0), 15 + np.arange(10.0)])), "gaps"),
        ((np.where(np.arange(20) == 5, np.nan, 1.0), 1.0), "row 5"),
        ((np.ones(20), 1.0, [11.0]), "taus"),
        ((np.ones(20), 1.0, [0.1]), "taus"),
        ((np.ones(20), 1.0, []), "taus"),
        ((cc.SensorLog(star=([0.0], [[1.0, 0, 0, 0]])),), "no gyro"),
        ((cc.SensorLog(gyro=([0.0, 1.0], np.ones((2, 3)))), 1.0), "comes with the log"),
    ],
)
def test_bad_readings_are_named(arguments: tuple[object, ...], words: str) -> None:
    with pytest.raises(InputError, match=words):
        allan_deviation(*arguments)  # type: ignore[arg-type]


def test_bad_fits_are_named() -> None:
    curve = allan_deviation(np.random.default_rng(14).standard_normal(1000), 1.0)
    with pytest.raises(InputError, match="choose from"):
        fit_allan(curve, ["arw", "drift"])
    with pytest.raises(InputError, match="choose from"):
        fit_allan(curve, [])
    with pytest.raises(InputError, match="curve"):
        fit_allan(np.ones(3))  # type: ignore[arg-type]
    with pytest.raises(InputError, match="averaging times"):
        fit_allan(allan_deviation(np.random.default_rng(15).standard_normal(1000), 1.0, [1, 2, 4]))
    with pytest.raises(InputError, match="do not change"):
        fit_allan(allan_deviation(np.zeros(1000), 1.0))


def test_types() -> None:
    curve = allan_deviation(np.random.default_rng(16).standard_normal(1000), 1.0)
    assert isinstance(curve, AllanDeviation)
    assert isinstance(fit_allan(curve, "arw"), AllanFit)
