"""One family of errors, messages that name field, row and value, units that are right."""

from __future__ import annotations

import math
import pickle
import subprocess
import sys
import warnings

import celestcore._check as check
import celestcore.units as units
import numpy as np
import pytest
from celestcore import errors
from celestcore._optional import require
from celestcore.errors import (
    CelestcoreError,
    CelestcoreWarning,
    InputError,
    LogFormatError,
    MissingDependencyError,
    NumericalError,
)


def test_one_family_and_the_builtin_bases() -> None:
    for cls, builtin in (
        (InputError, ValueError),
        (LogFormatError, InputError),
        (NumericalError, ArithmeticError),
        (MissingDependencyError, ImportError),
    ):
        assert issubclass(cls, CelestcoreError)
        assert issubclass(cls, builtin)
    assert issubclass(CelestcoreWarning, UserWarning)
    assert not issubclass(CelestcoreWarning, CelestcoreError)
    assert sorted(errors.__all__) == errors.__all__


@pytest.mark.parametrize(
    ("details", "expected"),
    [
        ({}, "broken"),
        ({"field": "gyro.t"}, "gyro.t: broken"),
        ({"field": "gyro.t", "row": np.int64(3)}, "gyro.t, row 3: broken"),
        ({"row": 0, "value": 0}, "row 0, value 0: broken"),
        ({"field": "q", "value": np.array([1.0, 0.0])}, "q, value (1.0, 0.0): broken"),
        ({"field": "q", "value": np.float64(2.5)}, "q, value 2.5: broken"),
        ({"field": "c", "value": np.eye(2)}, "c, value ((1.0, 0.0), (0.0, 1.0)): broken"),
        ({"field": "s", "value": "deg"}, "s, value 'deg': broken"),
        ({"field": "q", "source": "a.npz"}, "a.npz: q: broken"),
    ],
)
def test_message_puts_the_details_in_front(details: dict[str, object], expected: str) -> None:
    assert str(InputError("broken", **details)) == expected  # type: ignore[arg-type]


def test_long_values_are_cut() -> None:
    assert len(str(InputError("m", value="x" * 1000))) < 100


@pytest.mark.parametrize(
    "error",
    [
        InputError("m", field="f", row=2, value=(1.0, 2.0), source="s"),
        LogFormatError("m", field="f"),
        NumericalError("m", step=7, time=0.5),
        MissingDependencyError("m"),
        CelestcoreError("m"),
    ],
)
def test_errors_survive_pickling(error: CelestcoreError) -> None:
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is type(error)
    assert str(copy) == str(error)
    assert vars(copy) == vars(error)


def test_located_keeps_the_class_and_the_original() -> None:
    error = LogFormatError("m", field="f", row=1)
    named = error.located("a.csv")
    assert type(named) is LogFormatError
    assert str(named) == "a.csv: f, row 1: m"
    assert error.source is None


def test_numerical_error_names_step_and_time() -> None:
    assert str(NumericalError("m", step=0, time=0.0)) == "step 0, t = 0 s: m"
    assert str(NumericalError("m")) == "m"


def test_missing_package_says_what_to_install() -> None:
    with pytest.raises(MissingDependencyError) as caught:
        require("no_such_package.module", extra="parquet", what="reading Parquet")
    assert "reading Parquet needs no_such_package" in str(caught.value)
    assert "pip install 'celestcore[parquet]'" in str(caught.value)
    assert isinstance(caught.value, ImportError)


def test_warning_points_at_the_caller() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        check.warn("look here")
    assert [w.filename for w in caught] == [__file__]
    assert caught[0].category is CelestcoreWarning


def test_units_against_independent_values() -> None:
    assert math.isclose(units.DEG, math.radians(1.0), rel_tol=1e-16)
    assert math.isclose(units.ARCSEC, 4.84813681109536e-6, rel_tol=1e-15)
    assert math.isclose(units.ARCMIN, 60 * units.ARCSEC, rel_tol=1e-15)
    assert math.isclose(units.RPM, 0.10471975511965977, rel_tol=1e-15)
    # a random walk of 1 deg/sqrt(h) has spread 1 deg after an hour
    assert math.isclose(units.DEG_PER_SQRT_HOUR * math.sqrt(3600.0), units.DEG, rel_tol=1e-15)
    one_hour = units.DEG_PER_HOUR_PER_SQRT_HOUR * math.sqrt(3600.0)
    assert math.isclose(one_hour, units.DEG_PER_HOUR, rel_tol=1e-15)
    assert all(isinstance(getattr(units, name), float) for name in units.__all__)


def test_only_numpy_is_imported() -> None:
    """The modules of logs and settings need nothing but numpy until a feature asks for more."""
    code = (
        "import sys; import celestcore.errors, celestcore.log, celestcore.io, celestcore.config;"
        "bad = {'pyarrow', 'pandas', 'scipy', 'astropy', 'typer', 'rich', 'matplotlib', 'tomli'};"
        "sys.exit(str(bad & set(sys.modules)) if bad & set(sys.modules) else 0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
