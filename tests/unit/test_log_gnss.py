"""Baselines in a log: what is stored, copied and dropped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pandas as pd
import pytest
from celestcore.io import read_log, write_log
from celestcore.log import BaselineTable, SensorLog

T = np.arange(4.0)
B = np.random.default_rng(5).uniform(0.5, 2.0, (4, 3, 3))


def holes() -> Any:
    """Baselines, some of them, and all of one row, missing."""
    b = B.copy()
    b[1, 2, 0] = np.nan
    b[2] = np.inf
    b[3, 0] = np.nan
    return b


def test_baselines_are_stored() -> None:
    log = SensorLog(baselines=(T, B))
    table = log.baselines
    assert isinstance(table, BaselineTable)
    np.testing.assert_array_equal(table.b, B)
    assert table.present.all()
    assert table.kept is None
    assert not table.b.flags.writeable
    assert not np.shares_memory(table.b, B)
    assert list(log.tables) == ["baselines"]
    assert repr(log) == "SensorLog(3 s: baselines 4 rows)"
    assert SensorLog(gyro=([0.0], [[0.0, 0.0, 0.0]])).baselines is None


def test_missing_baselines_are_nan_and_rows_without_any_are_dropped() -> None:
    log = SensorLog(baselines=(T, holes()))
    table = log.baselines
    assert table is not None
    assert table.t.tolist() == [0.0, 1.0, 3.0]
    assert table.rows.tolist() == [0, 1, 3]
    assert (table.missing, log.missing) == (1, 1)
    expected = [[True, True, True], [True, True, False], [False, True, True]]
    assert table.present.tolist() == expected
    assert np.isnan(table.b[~table.present]).all()


def test_another_logs_table_a_mapping_and_a_frame() -> None:
    log = SensorLog(baselines=(T, holes()))
    again = SensorLog(baselines=log.baselines).baselines
    assert again is not None
    assert log.baselines is not None
    np.testing.assert_array_equal(again.b, log.baselines.b)
    assert again.missing == 1
    columns = {"t": T} | {f"{x}{k + 1}": B[:, k, j] for k in range(3) for j, x in enumerate("xyz")}
    for given in (columns, pd.DataFrame(columns)):
        table = SensorLog(baselines=given).baselines
        assert table is not None
        np.testing.assert_array_equal(table.b, B)


@pytest.mark.parametrize("name", ["log", "log.npz", "log.csv"])
@pytest.mark.parametrize("number", [2, 3, 12])
def test_files(name: str, number: int, tmp_path: Path) -> None:
    b = np.random.default_rng(1).uniform(0.5, 2.0, (4, number, 3))
    b[0, 1] = np.nan
    star = (T[:3] + 0.5, np.tile([1.0, 0.0, 0.0, 0.0], (3, 1)))
    write_log(SensorLog(baselines=(T, b), star=star), tmp_path / name)
    table = read_log(tmp_path / name).baselines
    assert table is not None
    np.testing.assert_array_equal(table.b, b)
    np.testing.assert_array_equal(table.t, T)


def test_the_columns_names(tmp_path: Path) -> None:
    write_log(SensorLog(baselines=(T, B[:, :2])), tmp_path / "log.npz")
    with np.load(tmp_path / "log.npz") as stored:
        assert list(stored) == [f"baselines_{c}" for c in ("t", "x1", "y1", "z1", "x2", "y2", "z2")]
        np.testing.assert_array_equal(stored["baselines_y2"], B[:, 1, 1])
    text = "t,baselines_x1,baselines_y1,baselines_z1,baselines_x2,baselines_y2,baselines_z2\n"
    (tmp_path / "log.csv").write_text(text + "0,1,0,0,,,\n1,1,0,0,0,1,0\n2,,,,,,\n")
    table = read_log(tmp_path / "log.csv").baselines
    assert table is not None
    assert table.present.tolist() == [[True, False], [True, True]]


def test_a_missing_column_is_named(tmp_path: Path) -> None:
    columns = {f"baselines_{x}{k}": T + 1.0 for x in "xyz" for k in (1, 3)} | {"baselines_t": T}
    np.savez(tmp_path / "log.npz", **columns)  # type: ignore[arg-type]
    with pytest.raises(cc.LogFormatError, match=r"baselines: columns x2, y2, z2 missing"):
        read_log(tmp_path / "log.npz")
    with pytest.raises(cc.LogFormatError, match=r"column z2 missing"):
        SensorLog(baselines={"t": T, **dict.fromkeys(["x1", "y1", "z1", "x2", "y2"], T + 1.0)})
