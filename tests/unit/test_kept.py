"""What a run keeps of its measurements: the option `innovations`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import analysis, plot, report
from celestcore.summary import headline, summary

NAV = cc.StarGyroNavigator(
    cc.EKF(), cc.Gyro(3.3e-5, 3.3e-8, sampling="average"), cc.StarCamera(2 * cc.ARCSEC), gate=0.4
)


@pytest.fixture(scope="module")
def log() -> cc.SensorLog:
    return cc.sample("fermi")


@pytest.fixture(scope="module")
def runs(log: cc.SensorLog) -> dict[str, cc.Solution]:
    kinds = ("full", "nis", "none")
    return {kind: NAV.run(log, every=100, innovations=kind) for kind in kinds}


def test_full_is_the_default(log: cc.SensorLog, runs: dict[str, cc.Solution]) -> None:
    sol, full = NAV.run(log, every=100), runs["full"]
    assert sol.innovations == full.innovations == "full"
    assert np.array_equal(sol.innovation, full.innovation)


@pytest.mark.parametrize("kind", ["nis", "none"])
def test_states_counts_and_likelihood_are_the_same(kind: str, runs: dict[str, cc.Solution]) -> None:
    sol, full = runs[kind], runs["full"]
    for name in ("t", "q", "rate", "bias", "sigma", "gaps"):
        assert np.array_equal(getattr(sol, name), getattr(full, name))
    assert sol.counts == full.counts
    assert sol.counts["accepted"] > 1000
    assert sol.counts["rejected"] > 0
    assert sol.log_likelihood == full.log_likelihood
    assert np.array_equal(sol.final["covariance"], full.final["covariance"])


def test_nis_keeps_all_but_innovations(runs: dict[str, cc.Solution]) -> None:
    sol, full = runs["nis"], runs["full"]
    for name in ("measurement_t", "sensor", "nis", "dof", "accepted"):
        assert np.array_equal(getattr(sol, name), getattr(full, name))
    for column in (sol.innovation, sol.innovation_sigma):
        assert column.shape == full.innovation.shape
        assert np.isnan(column).all()
        assert column.base is None or column.strides == (0, 0)  # no memory
    assert np.array_equal(analysis.nis(sol), analysis.nis(full))
    assert sol.measurement_columns()["nis"].shape == full.nis.shape
    part = sol[100.0:200.0]
    assert part.counts == full[100.0:200.0].counts


def test_none_keeps_no_rows(runs: dict[str, cc.Solution]) -> None:
    sol = runs["none"]
    assert sol.innovation.shape == (0, 3)
    assert len(sol.measurement_t) == len(sol.nis) == len(sol.accepted) == 0
    assert "measurements not kept" in repr(sol)
    assert set(sol[100.0:200.0].counts) == {"samples", "gaps"}


MISSING: list[tuple[str, Any]] = [
    ("nis", lambda s: s.plot(("innovation",))),
    ("nis", lambda s: analysis.whiteness(s)),
    ("none", lambda s: s.plot(("nis",))),
    ("none", lambda s: analysis.nis(s)),
    ("none", lambda s: analysis.whiteness(s)),
    ("none", lambda s: s.measurement_columns()),
    ("none", lambda s: s.to_dataframe(measurements=True)),
]


@pytest.mark.parametrize(("kind", "use"), MISSING)
def test_use_of_what_is_not_kept_says_so(kind: str, use: Any, runs: dict[str, cc.Solution]) -> None:
    with pytest.raises(cc.InputError, match="were not kept: run with innovations="):
        use(runs[kind])


@pytest.mark.parametrize("kind", ["nis", "none"])
def test_plots_and_reports_do_without(
    kind: str, log: cc.SensorLog, runs: dict[str, cc.Solution], tmp_path: Path
) -> None:
    sol = runs[kind]
    panels = {"nis": ("attitude", "bias", "sigma", "nis"), "none": ("attitude", "bias", "sigma")}
    assert plot.kept(sol) == panels[kind]
    assert sol.plot().axes
    result = summary(sol, log, gate=0.99)
    words = headline(result)
    assert "No fix was used" not in words
    assert ("Innovations were not kept" in words) == (kind == "none")
    assert result["counts"]["accepted"] == sol.counts["accepted"]
    for ending in ("html", "png"):
        report.write_report(tmp_path / f"r.{ending}", sol, result)
    page = (tmp_path / "r.html").read_text()
    assert f"Not kept: innovations={kind!r}".replace("'", "&#x27;") in page or (
        f"Not kept: innovations={kind!r}" in page
    )


def test_smoothing_keeps_what_the_run_did(log: cc.SensorLog, runs: dict[str, cc.Solution]) -> None:
    part = cc.SensorLog(gyro=log.gyro, star=log.stars["star"])
    sol = NAV.run(part, every=1000, innovations="none")
    best = NAV.smooth(sol)
    assert best.innovations == "none"
    assert best.counts == sol.counts
    assert NAV.smooth(sol, innovations="full").innovation.shape[0] > 1000


@pytest.mark.parametrize("value", ["all", "", None, True])
def test_unknown_words_are_refused(value: Any, log: cc.SensorLog) -> None:
    with pytest.raises(cc.InputError, match=r"innovations.*full, nis, none"):
        NAV.run(log, innovations=value)
