"""`Solution`: indexing by time, tables, files."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from celestcore.errors import InputError, MissingDependencyError
from celestcore.solution import Solution

MakeSolution = Callable[..., Solution]

COLUMNS = ["t", "qw", "qx", "qy", "qz", "wx", "wy", "wz", "bx", "by", "bz"]
COLUMNS += ["s_ax", "s_ay", "s_az", "s_bx", "s_by", "s_bz"]


def test_at_a_row_gives_the_row(solution: Solution) -> None:
    state = solution.at(solution.t[[0, 7, -1]])
    np.testing.assert_allclose(state.q, solution.q[[0, 7, -1]], atol=1e-15)
    np.testing.assert_allclose(state.bias, solution.bias[[0, 7, -1]], rtol=1e-14)
    np.testing.assert_allclose(state.sigma, solution.sigma[[0, 7, -1]], rtol=1e-14)


def test_at_between_rows_follows_the_turn(solution: Solution) -> None:
    state = solution[100.25]
    assert state.q.shape == (4,)
    assert state.rate.shape == (3,)
    assert state.sigma.shape == (6,)
    half = 0.5 * 1.1e-3 * 100.25
    expected = [np.cos(half), *(np.sin(half) * np.array([2.0, -1.0, 2.0]) / 3.0)]
    np.testing.assert_allclose(state.q, expected, atol=1e-14)
    middle = 0.75 * solution.sigma[100] + 0.25 * solution.sigma[101]
    np.testing.assert_allclose(state.sigma, middle, rtol=1e-12)


def test_at_interpolates_the_covariance(make_solution: MakeSolution) -> None:
    covariance = np.arange(3)[:, None, None] * np.eye(6)
    sol = make_solution(3, covariance=covariance)
    assert sol.at([[0.5], [1.5]]).covariance.shape == (2, 1, 6, 6)
    np.testing.assert_allclose(sol[0.5].covariance, 0.5 * np.eye(6))


@pytest.mark.parametrize("t", [-1.0, 2000.5, np.nan])
def test_at_outside_names_the_time_and_the_span(solution: Solution, t: float) -> None:
    with pytest.raises(InputError, match="spans 0 to 2000 s") as caught:
        solution.at([1.0, t])
    assert caught.value.row == 1


def test_a_slice_of_time_splits_exactly(solution: Solution) -> None:
    first, second = solution[:500.0], solution[500.0:]
    assert len(first) + len(second) == len(solution)
    assert len(first.measurement_t) + len(second.measurement_t) == len(solution.measurement_t)
    assert first.t[-1] < 500.0 <= second.t[0]
    assert len(first.gaps) == 0
    assert len(second.gaps) == 1
    assert second.counts["rejected"] == solution.counts["rejected"]
    assert first.final["t"] == first.t[-1]
    first.q[:] = 0.0
    assert solution.q[0, 0] == 1.0, "a slice must be a copy"


def test_an_empty_slice_is_an_empty_solution(solution: Solution) -> None:
    nothing = solution[1e9:]
    assert len(nothing) == 0
    assert "empty" in repr(nothing)
    with pytest.raises(InputError, match="empty"):
        nothing.at(0.0)


def test_a_slice_with_a_step_is_refused(solution: Solution) -> None:
    with pytest.raises(InputError, match="without a step"):
        solution[0:10:2]


def test_as_rotation_agrees(solution: Solution) -> None:
    turned = solution.as_rotation().apply([1.0, 0.0, 0.0])[-1]
    w, x, y, z = solution.q[-1]
    np.testing.assert_allclose(
        turned, [1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)], atol=1e-14
    )
    assert solution[3.0].as_rotation().single


def test_dataframe_columns(solution: Solution) -> None:
    frame = solution.to_dataframe()
    assert list(frame.columns) == COLUMNS
    np.testing.assert_array_equal(frame["qz"], solution.q[:, 3])
    assert frame.attrs["epoch"] == solution.epoch
    fixes = solution.to_dataframe(measurements=True)
    assert list(fixes["sensor"].unique()) == ["star"]
    assert fixes["accepted"].sum() == solution.counts["accepted"]
    frame["t"] = 0.0
    assert solution.t[-1] == 2000.0, "a data frame must be a copy"


def test_parquet_holds_rows_measurements_and_metadata(
    make_solution: MakeSolution, tmp_path: Path
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    sol = make_solution(50, sensors=3, covariance=np.tile(np.eye(6), (50, 1, 1)))
    sol.to_parquet(tmp_path / "a.parquet", measurements=tmp_path / "m.parquet")
    table = parquet.read_table(tmp_path / "a.parquet")
    assert table.column_names[:17] == COLUMNS
    assert table.column_names[17] == "p_11"
    assert table.column_names[-1] == "p_66"
    np.testing.assert_array_equal(table["s_bz"].to_numpy(), sol.sigma[:, 5])
    note = json.loads(table.schema.metadata[b"celestcore"])
    assert note["epoch"] == sol.epoch
    assert note["frames"] == {"inertial": "not given", "body": "not given"}
    assert note["units"]["q"] == "1"
    assert note["version"]
    fixes = parquet.read_table(tmp_path / "m.parquet").to_pydict()
    assert fixes["sensor"][:3] == ["star", "star_1", "vector_sun"]
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.parquet", "m.parquet"]


def test_metadata_has_the_frames_that_were_given(make_solution: MakeSolution) -> None:
    frames = make_solution(10, frames={"inertial": "ICRF"}).metadata()["frames"]
    assert frames == {"inertial": "ICRF", "body": "not given"}


def test_parquet_into_a_missing_directory_is_refused(solution: Solution, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"):
        solution.to_parquet(tmp_path / "no" / "a.parquet")


def test_a_failed_write_leaves_the_old_file(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "a.parquet"
    path.write_text("old")

    def broken(table: object, target: Path, **_: object) -> None:
        target.write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr(parquet, "write_table", broken)
    with pytest.raises(OSError, match="disk full"):
        solution.to_parquet(path)
    assert [p.name for p in tmp_path.iterdir()] == ["a.parquet"]
    assert path.read_text() == "old"


def test_a_missing_package_is_named(
    solution: Solution, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "pyarrow", None)
    with pytest.raises(MissingDependencyError, match=r"celestcore\[parquet\]"):
        solution.to_parquet(tmp_path / "a.parquet")
