"""Settings: the TOML schema, its units, merging, and the navigator it describes."""

from __future__ import annotations

import importlib.util
import inspect
import math
import sys
from datetime import date, datetime
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from celestcore import _settings_keys, _toml, config
from celestcore.cli import describe_settings
from celestcore.config import Settings
from celestcore.errors import CelestcoreError, InputError, LogFormatError, MissingDependencyError
from celestcore.log import SensorLog
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.units import ARCSEC, DEG
from hypothesis import given
from hypothesis import strategies as st

FULL = """
[log]
title = "a log"
epoch = 2026-01-01T00:00:00
source = "somewhere"
licence = "CC0"

[frames]
inertial = "GCRS"
body = "bus"

[gyro]
arw = 1.5e-6
rrw = 3e-9
sampling = "average"
mounting = [0.0, 1.0, 0.0, 0.0]
max_gap_s = 2
gap_rate_sigma = 1e-4

[star_1]
sigma_arcsec = 5

[star_2]
sigma = [1e-5, 1e-5, 4e-5]
mounting = [0.0, 0.0, 0.0, 1.0]
frame = "body"

[vector_sun]
sigma_deg = 0.5

[filter]
kind = "ukf"
alpha = 0.5
beta = 2
kappa = 0.0
integrator = "rk4"

[gate]
probability = 0.999

[start]
sigma_attitude_arcsec = 60
sigma_bias = 1e-5
"""


def full(tmp_path: Path) -> Settings:
    path = tmp_path / "full.toml"
    path.write_text(FULL)
    return Settings.from_toml(path)


def test_every_key_reaches_its_sensor(tmp_path: Path) -> None:
    settings = full(tmp_path)
    assert settings.gyro() == Gyro(
        1.5e-6,
        3e-9,
        sampling="average",
        mounting=(0.0, 1.0, 0.0, 0.0),
        max_gap=2.0,
        gap_rate_sigma=1e-4,
    )
    assert settings.stars() == {
        "star_1": StarCamera(5 * ARCSEC),
        "star_2": StarCamera((1e-5, 1e-5, 4e-5), mounting=(0.0, 0.0, 0.0, 1.0)),
    }
    assert settings.vectors() == {"sun": VectorSensor(0.5 * DEG)}
    assert settings.gate() == 0.999
    assert settings.sigma0() == (60 * ARCSEC, 1e-5)
    assert settings.tables["log"]["epoch"] == "2026-01-01T00:00:00"
    assert settings.tables["frames"] == {"inertial": "GCRS", "body": "bus"}


def test_the_docstring_lists_every_key() -> None:
    doc = inspect.getdoc(config) or ""
    for table, keys in _settings_keys.KEYS.items():
        assert f"[{table}" in doc
        for key in keys:
            assert key in doc, key


def test_navigator_and_filter(tmp_path: Path) -> None:
    from celestcore.filters import EKF, UKF

    settings = full(tmp_path)
    built = settings.filter()
    assert isinstance(built, UKF)
    assert (built.alpha, built.beta, built.kappa) == (0.5, 2.0, 0.0)
    assert built.integrator == "rk4"
    navigator = settings.navigator()
    assert navigator.gyro == settings.gyro()
    assert isinstance(Settings.from_dict({"gyro": {"arw": 1e-6}}).filter(), EKF)
    Settings.from_dict({"gyro": {"arw": 1e-6}}).navigator()


def test_gyro_without_noise_says_what_to_add() -> None:
    with pytest.raises(InputError, match=r"add a line arw = \.\.\. to the table \[gyro\]"):
        Settings().navigator()


def test_vector_without_noise_says_what_to_add() -> None:
    settings = Settings.from_dict({"vector_sun": {"mounting": [1, 0, 0, 0]}})
    with pytest.raises(InputError, match=r"add sigma_deg = \.\.\. to the table \[vector_sun\]"):
        settings.vectors()


def test_the_settings_of_a_log() -> None:
    log = SensorLog(gyro=([0.0], [[0.0] * 3]), settings={"gyro": {"arw": 1e-6}})
    assert Settings.from_log(log).gyro() == Gyro(1e-6)


def test_defaults() -> None:
    settings = Settings()
    assert settings.gate() is None
    assert settings.sigma0() is None
    assert settings.stars() == {}
    assert settings.vectors() == {}


BAD: dict[str, tuple[Any, str, str]] = {
    "unknown table": ({"gyros": {}}, "[gyros]", "known are log, frames, gyro, star"),
    "horizon": ({"horizon": {"sigma": 1}}, "[horizon]", "unknown table"),
    "no table": ({"gyro": 3}, "gyro", "write [gyro]"),
    "unknown key": ({"gyro": {"ARW": 1}}, "gyro.ARW", "known are arw, rrw"),
    "key of star": ({"star_1": {"sigma_deg": 1}}, "star_1.sigma_deg", "sigma_arcsec"),
    "text for number": ({"gyro": {"arw": "1e-6"}}, "gyro.arw", "a number"),
    "truth for number": ({"gyro": {"arw": True}}, "gyro.arw", "a number"),
    "number for text": ({"gyro": {"sampling": 1}}, "gyro.sampling", "a text"),
    "number for list": ({"gyro": {"mounting": 1}}, "gyro.mounting", "a list"),
    "text for sigma": ({"star": {"sigma": "5"}}, "star.sigma", "a number or a list of three"),
    "text in sigma": ({"star": {"sigma_arcsec": [1, "5", 1]}}, "star.sigma_arcsec", "real numbers"),
    "two of sigma": ({"star_2": {"sigma": [1e-5, 1e-5]}}, "star_2.sigma", "one number or three"),
    "two units": ({"star": {"sigma": 1e-5, "sigma_arcsec": 1}}, "star.sigma_arcsec", "twice"),
    "sigma and covariance": (
        {"star": {"sigma": 1e-5, "covariance": np.eye(3)}},
        "star",
        "not both",
    ),
    "negative": ({"gyro": {"arw": -1e-6}}, "gyro.arw", "greater than 0"),
    "negative rrw": ({"gyro": {"rrw": -1e-6}}, "gyro.rrw", "at least 0"),
    "nan": ({"gyro": {"arw": math.nan}}, "gyro.arw", "finite"),
    "gap": ({"gyro": {"max_gap_s": 0}}, "gyro.max_gap", "greater than 0"),
    "sampling": ({"gyro": {"sampling": "middle"}}, "gyro.sampling", "hold, integrated, average"),
    "mounting": ({"star_a": {"mounting": [1, 1, 0, 0]}}, "star_a.mounting", "norm 1.41421"),
    "zero sigma": ({"star_a": {"sigma_arcsec": 0}}, "star_a.sigma", "greater than 0"),
    "vector sigma": ({"vector_m": {"sigma_deg": -1}}, "vector_m.sigma", "greater than 0"),
    "kind": ({"filter": {"kind": "EKF"}}, "filter.kind", "ekf, ukf, srukf"),
    "integrator": ({"filter": {"integrator": "euler"}}, "filter.integrator", "exponential, rk4"),
    "alpha of ekf": ({"filter": {"kind": "ekf", "alpha": 1}}, "filter.alpha", "srukf and literal"),
    "percent": ({"gate": {"probability": 99.9}}, "gate.probability", "between 0 and 1"),
    "probability 0": ({"gate": {"probability": 0}}, "gate.probability", "between 0 and 1"),
    "probability nan": ({"gate": {"probability": math.nan}}, "gate.probability", "between"),
    "start": ({"start": {"sigma_bias": 0.0}}, "start.sigma_bias", "greater than 0"),
    "epoch": ({"log": {"epoch": "noon"}}, "epoch", "ISO"),
    "epoch type": ({"log": {"epoch": 5}}, "log.epoch", "ISO"),
    "frame": ({"frames": {"inertal": "GCRS"}}, "frames.inertal", "known are inertial, body, earth"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_settings_name_the_key(name: str) -> None:
    document, field, part = BAD[name]
    with pytest.raises(InputError) as caught:
        Settings.from_dict(document)
    assert caught.value.field == field
    assert part in str(caught.value)


def test_errors_of_a_file_name_the_file(tmp_path: Path) -> None:
    path = tmp_path / "bad.toml"
    path.write_text("[gyro]\nARW = 1\n")
    with pytest.raises(InputError, match=rf"^{path}: gyro\.ARW: unknown key"):
        Settings.from_toml(path)
    path.write_text("[gyro\n")
    with pytest.raises(LogFormatError, match=rf"^{path}: is not valid TOML: .*line 1"):
        Settings.from_toml(path)
    with pytest.raises(LogFormatError, match="No such file"):
        Settings.from_toml(tmp_path / "none.toml")
    with pytest.raises(LogFormatError, match="directory"):
        Settings.from_toml(tmp_path)


def test_start_needs_both() -> None:
    with pytest.raises(InputError, match="both"):
        Settings.from_dict({"start": {"sigma_bias": 1e-5}}).sigma0()


# ------------------------------------------------------------------ merging


def test_merging_wins_key_by_key(tmp_path: Path) -> None:
    base = full(tmp_path)
    merged = base.merged({"gyro": {"arw": 2e-6}, "gate": {"probability": 0.9}})
    assert merged.gyro().arw == 2e-6
    assert merged.gyro().rrw == 3e-9
    assert merged.gate() == 0.9
    assert base.gyro().arw == 1.5e-6
    assert base.gate() == 0.999
    assert merged.merged({}) == merged
    assert base.merged(base) == base


def test_merging_noise_of_another_kind_replaces_it(tmp_path: Path) -> None:
    base = full(tmp_path)
    one = base.merged({"star_1": {"sigma": 1e-5}}).stars()["star_1"]
    assert one == StarCamera(1e-5)
    two = base.merged({"star_2": {"covariance": 1e-10 * np.eye(3)}}).stars()["star_2"]
    assert two == StarCamera(covariance=1e-10 * np.eye(3), mounting=(0.0, 0.0, 0.0, 1.0))
    assert Settings(base.tables).merged({"star_1": {"mounting": [1, 0, 0, 0]}}).stars()[
        "star_1"
    ] == (StarCamera(5 * ARCSEC, mounting=(1.0, 0.0, 0.0, 0.0)))


def test_merging_another_filter_drops_the_options_of_the_first(tmp_path: Path) -> None:
    base = full(tmp_path)
    assert base.merged({"filter": {"kind": "ekf"}}).tables["filter"] == {"kind": "ekf"}
    assert base.merged({"filter": {"kind": "ukf"}}) == base
    only_alpha = Settings.from_dict({"filter": {"alpha": 0.1}})
    assert base.merged(only_alpha).tables["filter"]["alpha"] == 0.1
    with pytest.raises(InputError, match="srukf and literal"):
        only_alpha.filter()
    by_rk4 = Settings.from_dict({"filter": {"kind": "ekf", "integrator": "rk4"}}).filter()
    assert by_rk4.integrator == "rk4"


def test_merging_shares_nothing(tmp_path: Path) -> None:
    base = full(tmp_path)
    merged = base.merged({})
    merged.tables["gyro"]["mounting"][0] = 9.0
    assert base.tables["gyro"]["mounting"][0] == 0.0


# ------------------------------------------------------------------ TOML

text = st.text(st.characters(codec="utf-8"))
scalars = st.one_of(
    text,
    st.booleans(),
    st.integers(-(2**63), 2**63 - 1),
    st.floats(allow_nan=False),
    st.datetimes(datetime(1000, 1, 1)),
    st.dates(date(1000, 1, 1)),
)
values = st.recursive(scalars, st.lists, max_leaves=6)


@given(st.dictionaries(text, st.dictionaries(text, values, max_size=4), max_size=4))
def test_toml_round_trip(document: dict[str, dict[str, Any]]) -> None:
    assert _toml.parse_toml(_toml.dump_toml(document)) == document


def test_toml_of_numpy_values() -> None:
    text = _toml.dump_toml({"a": {"x": np.float64(0.5), "y": np.arange(2.0), "z": np.int8(3)}})
    assert _toml.parse_toml(text) == {"a": {"x": 0.5, "y": [0.0, 1.0], "z": 3}}


def test_toml_refuses_what_it_cannot_hold() -> None:
    with pytest.raises(InputError) as caught:
        _toml.dump_toml({"gyro": {"arw": None}})
    assert caught.value.field == "gyro.arw"


def test_without_a_toml_reader_one_sentence(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "a.toml").write_text(FULL)
    monkeypatch.setattr(sys, "version_info", (3, 10, 0))
    if importlib.util.find_spec("tomli"):
        assert Settings.from_toml(tmp_path / "a.toml").gyro().arw == 1.5e-6
    monkeypatch.setitem(sys.modules, "tomli", None)
    with pytest.raises(MissingDependencyError, match="reading TOML needs tomli") as caught:
        Settings.from_toml(tmp_path / "a.toml")
    assert isinstance(caught.value, CelestcoreError)


@pytest.mark.parametrize(
    ("gate", "expected"),
    [
        ({}, {"Gate": "none: every fix is used"}),
        (
            {"probability": 0.999, "adaptive": 300},
            {
                "Gate": "rejects fixes outside 99.9 % of the chi-square law",
                "Noise": "found as the filter runs, from about 300 fixes",
            },
        ),
        (
            {"huber": 1.5},
            {
                "Gate": "none: every fix is used, doubtful ones with less weight",
                "Doubtful fixes": "Huber's weights beyond 1.5 sigmas",
            },
        ),
        (
            {"student_t": 4},
            {
                "Gate": "none: every fix is used, doubtful ones with less weight",
                "Doubtful fixes": "Student's weights with 4 degrees of freedom",
            },
        ),
    ],
)
def test_a_report_tells_how_far_fixes_are_believed(
    gate: dict[str, float], expected: dict[str, str]
) -> None:
    settings = Settings.from_dict({"gyro": {"arw": 1e-6}, "gate": gate})
    words = describe_settings(settings)
    shown = {name: words[name] for name in ("Gate", "Doubtful fixes", "Noise") if name in words}
    assert shown == expected
