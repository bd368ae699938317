"""Campaigns from a file: what it may say, the same bits however it is run, going on, faults."""

from __future__ import annotations

import copy
import random
from collections.abc import Callable, Mapping
from concurrent.futures import Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pytest
from celestcore import campaign, simulate
from celestcore.campaign import Campaign

parquet = pytest.importorskip("pyarrow.parquet")

CONFIG: dict[str, Any] = {
    "campaign": {"trials": 6, "seed": 5, "skip_s": 5.0},
    "scenario": {"profile": "slews", "duration_s": 30.0, "angle_deg": 30.0},
    "gyro": {"arw": 2e-5, "rrw": 1e-7, "bias_sigma": 1e-4},
    "star": {"sigma_arcsec": [4.0, 4.0, 20.0], "every": 2},
    "grid": {"filter.kind": ["ekf", "ukf"], "star.sigma_arcsec": [3, 9]},
}


def changed(**tables: Any) -> dict[str, Any]:
    """Return the configuration with keys changed; None takes a table away."""
    out = copy.deepcopy(CONFIG)
    for name, values in tables.items():
        out[name] = {**out.get(name, {}), **values} if isinstance(values, dict) else values
    return {name: values for name, values in out.items() if values is not None}


def plain(table: Any) -> Any:
    """Return rows without what the clock says."""
    return table.drop_columns([n for n in ("seconds", "elapsed_s") if n in table.column_names])


@pytest.fixture(scope="module")
def rows(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the rows of the whole campaign on one thread."""
    return plain(campaign.run(CONFIG, tmp_path_factory.mktemp("c") / "out", threads=1).table())


def test_a_row_is_what_monte_carlo_finds(rows: Any) -> None:
    truth = simulate.slews(30.0, angle=30 * cc.DEG)
    star = simulate.StarErrors(9 * cc.ARCSEC, every=2)
    scenario = simulate.Scenario(truth, simulate.GyroErrors(2e-5, 1e-7, bias_sigma=1e-4), star)
    found = cc.monte_carlo(scenario, scenario.navigator(cc.UKF()), 6, 5, skip=5.0)["ukf"]
    frame = rows.to_pandas()
    mine = frame[(frame["filter.kind"] == "ukf") & (frame["star.sigma_arcsec"] == 9.0)]
    assert mine["trial"].tolist() == list(range(6))
    np.testing.assert_array_equal(mine[["rms_x", "rms_y", "rms_z"]].to_numpy(), found.rms)
    np.testing.assert_array_equal(mine["nees"].to_numpy(), found.nees)
    np.testing.assert_array_equal(mine["final_error_bz"].to_numpy(), found.final_error[:, 5])
    assert set(mine["version"]) == {cc.__version__}
    assert not mine["lost"].any()
    assert mine["failure"].isna().all()


def test_one_row_a_run_in_order(rows: Any) -> None:
    assert rows.num_rows == 24
    assert len(set(rows["key"].to_pylist())) == 24
    assert rows["seed"].to_pylist() == [5] * 24
    assert rows["filter.kind"].to_pylist() == ["ekf"] * 12 + ["ukf"] * 12


class Shuffled:
    """Runs what it is handed in any order, and much later."""

    def __init__(self) -> None:
        self.held: list[tuple[Any, Any, Any]] = []
        self.pool = ThreadPoolExecutor(2)
        self.random = random.Random(3)

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        future: Future[Any] = Future()
        self.held.append((future, fn, args))
        self.random.shuffle(self.held)
        self.pool.submit(self._one)
        return future

    def _one(self) -> None:
        future, fn, args = self.held.pop()
        future.set_result(fn(*args))


class Bare:
    """Has futures with `result` alone."""

    def submit(self, fn: Callable[..., Any], /, *args: Any) -> Any:
        class Later:
            def result(self) -> Any:
                return fn(*args)

        return Later()


def spawned() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=get_context("spawn"))


@pytest.mark.parametrize("make", [Shuffled, Bare, lambda: ThreadPoolExecutor(2)])
@pytest.mark.parametrize("batch", [1, 4, None])
def test_same_bits_on_any_executor(make: Any, batch: Any, tmp_path: Path, rows: Any) -> None:
    config = changed(campaign={"batch": batch} if batch else {})
    assert plain(campaign.run(config, tmp_path / "o", executor=make()).table()).equals(rows)


def test_same_bits_on_threads_and_processes(tmp_path: Path, rows: Any) -> None:
    for threads in (2, 3):
        found = campaign.run(CONFIG, tmp_path / str(threads), threads=threads)
        assert plain(found.table()).equals(rows)
    assert plain(campaign.run(CONFIG, tmp_path / "p", executor=spawned).table()).equals(rows)


def test_finished_rows_are_not_run_again(tmp_path: Path, rows: Any) -> None:
    told: list[tuple[int, int]] = []
    small = changed(campaign={"trials": 2}, grid={"filter.kind": ["ekf"]})
    first = campaign.run(small, tmp_path / "o")
    assert (first.ran, first.kept) == (4, 0)
    more = campaign.run(CONFIG, tmp_path / "o", progress=lambda *x: told.append(x))
    assert (more.ran, more.kept) == (20, 4)
    assert told[0][0] > 4
    assert told[-1] == (24, 24)
    assert plain(more.table()).equals(rows)
    again = campaign.run(CONFIG, tmp_path / "o", progress=lambda *x: told.append(x))
    assert (again.ran, again.kept) == (0, 24)
    assert again.table().equals(more.table())


def test_goes_on_after_an_error(tmp_path: Path, rows: Any) -> None:
    """What ended before the error has been written."""

    class Enough(Exception):  # noqa: N818
        pass

    def stop(done: int, total: int) -> None:
        if done >= 10:
            raise Enough

    config = changed(campaign={"batch": 2})
    with pytest.raises(Enough):
        campaign.run(config, tmp_path / "o", threads=1, progress=stop)
    left = campaign.read(tmp_path / "o").num_rows
    assert 10 <= left < 24
    rest = campaign.run(config, tmp_path / "o")
    assert rest.kept == left
    assert plain(rest.table()).equals(rows)


def test_a_lost_part_is_run_again(tmp_path: Path, rows: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("celestcore.campaign._run.ROWS", 1)
    campaign.run(changed(campaign={"batch": 2}), tmp_path / "o")
    parts = sorted((tmp_path / "o").glob("part-*.parquet"))
    assert len(parts) == 12
    parts[3].unlink()
    (tmp_path / "o" / ".part-000003.abcd.tmp.parquet").write_bytes(b"half")
    rest = campaign.run(CONFIG, tmp_path / "o")
    assert (rest.ran, rest.kept) == (2, 22)
    assert plain(rest.table()).equals(rows)
    assert not list((tmp_path / "o").glob(".part*"))


def test_cells_pool_the_rows(tmp_path: Path, rows: Any) -> None:
    results = campaign.run(CONFIG, tmp_path / "o")
    cells = results.cells()
    assert [c["filter.kind"] for c in cells] == ["ekf", "ekf", "ukf", "ukf"]
    frame = rows.to_pandas().iloc[:6]
    assert cells[0]["rms"][0] == pytest.approx(np.sqrt(np.mean(frame["rms_x"] ** 2)))
    assert cells[0]["nis"] == pytest.approx(frame["nis"].mean())
    assert results.to_dict()["failed"] == 0
    assert len(results.to_dataframe()) == 24


def test_what_the_filter_assumes_may_differ(tmp_path: Path) -> None:
    config = changed(
        grid=None,
        campaign={"trials": 20},
        assumed={"star": {"sigma_arcsec": 1.0}},
    )
    (cell,) = campaign.run(config, tmp_path / "o").cells()
    assert cell["nis"] > 20.0
    config["assumed"] = {"gyro": {"arw": 3e-5}}
    (cell,) = campaign.run(config, tmp_path / "p").cells()
    assert 2.0 < cell["nis"] < 4.0


def test_smoothed_drawn_and_lists_in_the_grid(tmp_path: Path) -> None:
    config = changed(
        campaign={"trials": 16, "start": "drawn"},
        start={"sigma_attitude_arcsec": 60.0, "sigma_bias": 1e-4},
        grid={"campaign.smooth": [False, True], "star": {"sigma_arcsec": [[3, 3, 9], [5, 5, 20]]}},
    )
    del config["grid"]["filter.kind"], config["grid"]["star.sigma_arcsec"]
    cells = campaign.run(config, tmp_path / "o").cells()
    assert [c["campaign.smooth"] for c in cells] == [False, False, True, True]
    assert cells[0]["star.sigma_arcsec"] == "[3.0,3.0,9.0]"
    assert cells[2]["rms"][0] < cells[0]["rms"][0]


@pytest.mark.parametrize(
    ("tables", "words"),
    [
        ({"orbit": {}}, r"\[orbit\]: unknown table; known are campaign, grid"),
        ({"campaign": {"trails": 3}}, "campaign.trails: unknown key; known are"),
        ({"campaign": {"trials": 0}}, "campaign.trials, value 0: must be a whole number of"),
        ({"campaign": {"trials": 2.5}}, "campaign.trials, value 2.5: must be a whole number"),
        ({"campaign": {"smooth": 1}}, "campaign.smooth, value 1: must be true or false"),
        ({"campaign": {"seed": -1}}, "campaign.seed, value -1"),
        ({"campaign": {"skip_s": 30.0}}, "campaign.skip_s, value 30.0: leaves nothing to score"),
        ({"campaign": {"start": "late"}}, "start, value 'late': must be first_fix or drawn"),
        ({"campaign": {"start": "drawn"}}, r"\[start\]: is needed with start = .drawn."),
        ({"campaign": {"first": 2**56 - 2}}, "trials are counted"),
        ({"scenario": {"profile": "orbit"}}, "scenario.profile, value 'orbit': must be one of"),
        ({"scenario": {"raan_deg": 3}}, "scenario.raan_deg: is no key of the profile slews"),
        ({"scenario": {"duration": 3}}, "scenario.duration: unknown key; known are"),
        ({"scenario": {"step_s": -1}}, "scenario.step_s, value -1.0: must be greater than 0"),
        ({"scenario": None}, r"needs a table \[scenario\] to simulate, or \[logs\]"),
        ({"scenario": 3}, r"scenario, value 3: must be a table, write \[scenario\]"),
        ({"gyro": {"awr": 1e-6}}, "gyro.awr: unknown key"),
        ({"gyro": {"arw": 0.0}}, "gyro.arw, value 0.0"),
        ({"gyro": {"arw": "low"}}, "gyro.arw, value 'low': must be a number or a list"),
        ({"gyro": {"bias": 0.0, "bias_deg_per_hour": 1}}, "bias is given twice"),
        ({"gyro": None}, "are needed with"),
        ({"star": {"every": 2.5}}, "star.every, value 2.5: must be a whole number"),
        ({"star": {"period_s": 1.0}}, "star.period"),
        ({"star": {"offset_s": 1.0}}, "star.offset_s: does not go with"),
        ({"star_2": {"sigma_arcsec": -2}}, "star_2.sigma"),
        ({"assumed": {"star_7": {"sigma": 1e-5}}}, r"\[assumed.star_7\]: unknown table; flown"),
        ({"assumed": {"star": {"sigam": 1e-5}}}, "assumed.star.sigam: unknown key"),
        ({"filter": {"kind": "kalman"}, "grid": None}, "filter.kind, value 'kalman'"),
        ({"gate": {"probability": 2}}, "gate.probability"),
        ({"grid": {"filter.kind": ["ekf", "kf"]}}, "in the cell filter.kind = kf, star.sigma"),
        ({"grid": {"star.sigma_arcsec": []}}, "grid.star.sigma_arcsec: is empty"),
        ({"grid": {"star.sigma_arcsec": [2, 2.0]}}, "value 2.0: stands there twice"),
        ({"grid": {"star.sigma_arcsec": 2}}, "value 2: must be a list of values"),
        ({"grid": {"star.sgima": [2]}}, "star.sgima: unknown key"),
        ({"grid": {"star": {"sigma_arcsec": [2]}}}, "grid.star.sigma_arcsec: is given twice"),
        ({"grid": {"star.sigma": [1e-5]}}, "sigma is given twice, in different units"),
        ({"grid": {"campaign.trials": [2]}}, "grid.campaign.trials: cannot differ"),
        ({"grid": {"trials": [2]}}, "grid.trials: is no setting"),
        ({"grid": {"gyro.arw": [1e-6, [1e-6] * 3]}}, "values of one kind"),
    ],
)
def test_bad_configurations(tables: Mapping[str, Any], words: str, tmp_path: Path) -> None:
    with pytest.raises(cc.InputError, match=words):
        campaign.run(changed(**tables), tmp_path / "o")
    assert not (tmp_path / "o").exists()


def test_an_empty_grid_is_an_error() -> None:
    with pytest.raises(cc.InputError, match="grid: is empty: give lists"):
        Campaign.from_dict({**CONFIG, "grid": {}})


def test_another_campaigns_folder_is_refused(tmp_path: Path) -> None:
    campaign.run(CONFIG, tmp_path / "o")
    before = {p.name: p.read_bytes() for p in (tmp_path / "o").iterdir()}
    for other, words in [
        (changed(campaign={"seed": 6}), "holds 24 rows that this campaign does not ask for"),
        (changed(campaign={"trials": 5}), "holds 4 rows that this campaign does not ask for"),
        (changed(gyro={"rrw": 2e-7}), "holds 24 rows"),
        (changed(grid={"gyro.rrw": [1e-7]}), "of another campaign, with other columns: gyro.rrw"),
    ]:
        with pytest.raises(cc.InputError, match=words):
            campaign.run(other, tmp_path / "o")
    assert {p.name: p.read_bytes() for p in (tmp_path / "o").iterdir()} == before


def test_a_damaged_part_is_named(tmp_path: Path) -> None:
    campaign.run(CONFIG, tmp_path / "o")
    (part,) = (tmp_path / "o").glob("part-*.parquet")
    whole = part.read_bytes()
    for damaged in (whole[: len(whole) // 2], flipped(whole, 400), b""):
        part.write_bytes(damaged)
        for call in (
            lambda: campaign.run(CONFIG, tmp_path / "o"),
            lambda: campaign.read(tmp_path / "o"),
        ):
            with pytest.raises(cc.InputError, match=r"part-000000.parquet: is damaged .*delete it"):
                call()
    part.unlink()
    assert campaign.run(CONFIG, tmp_path / "o").ran == 24


def flipped(data: bytes, place: int) -> bytes:
    return data[:place] + bytes([data[place] ^ 0x10]) + data[place + 1 :]


def test_folders_that_will_not_do(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(cc.InputError, match="cannot be made"):
        campaign.run(CONFIG, tmp_path / "file")
    with pytest.raises(cc.InputError, match="cannot be made"):
        campaign.run(CONFIG, tmp_path / "file" / "below")
    (tmp_path / "notes").mkdir()
    (tmp_path / "notes" / "thesis.tex").write_text("")
    with pytest.raises(cc.InputError, match=r"holds thesis\.tex, which is no part of a campaign"):
        campaign.run(CONFIG, tmp_path / "notes")


def test_an_unwritable_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.access", lambda *_: False)  # the tests may run as root
    with pytest.raises(cc.InputError, match="is not writable"):
        campaign.run(CONFIG, tmp_path / "o")


def test_a_full_disk_keeps_what_is_complete(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr("celestcore.campaign._run.ROWS", 1)
    write, left = parquet.write_table, [3]

    def full(table: Any, where: Any, **options: Any) -> None:
        left[0] -= 1
        if left[0] < 0:
            Path(where).write_bytes(b"half")
            raise OSError(28, "No space left on device")
        write(table, where, **options)

    config = changed(campaign={"batch": 1})
    with monkeypatch.context() as patch:
        patch.setattr("pyarrow.parquet.write_table", full)
        with pytest.raises(OSError, match="No space left"):
            campaign.run(config, tmp_path / "o", threads=1)
    assert campaign.read(tmp_path / "o").num_rows == 3
    assert campaign.run(config, tmp_path / "o").kept == 3


def test_two_campaigns_in_one_folder(tmp_path: Path) -> None:
    def again(done: int, total: int) -> None:
        campaign.run(CONFIG, tmp_path / "o")

    with pytest.raises(cc.InputError, match="another campaign is writing into it"):
        campaign.run(CONFIG, tmp_path / "o", threads=1, progress=again)


def test_a_filter_that_breaks_down_is_a_row(tmp_path: Path) -> None:
    """A negative weight, and a start that it matters for."""
    config = {
        "campaign": {"trials": 8, "first": 10, "start": "drawn"},
        "scenario": {"profile": "earth_pointing", "duration_s": 60.0, "step_s": 1.0},
        "gyro": {"arw": 1e-6},
        "star": {"sigma": 1e-11},
        "filter": {"beta": 0.0},
        "start": {"sigma_attitude": 3.0, "sigma_bias": 1.0},
        "grid": {"filter.kind": ["ukf"]},
    }
    results = campaign.run(config, tmp_path / "o")
    table = results.table().to_pandas()
    bad = table["failure"].notna()
    assert bad.any()
    assert table["failure"][bad].str.contains("not positive definite").all()
    assert (table["nees"].isna() == bad).all()
    assert not table["lost"].any()
    cell = results.cells()[0]
    assert (cell["runs"], cell["failed"]) == (8, int(bad.sum()))
    assert campaign.run(config, tmp_path / "o").ran == 0


def test_a_sweep_of_a_unit_replaces_another(tmp_path: Path) -> None:
    config = changed(star={"sigma": 1e-5}, grid=None)
    del config["star"]["sigma_arcsec"]
    swept = Campaign.from_dict({**config, "grid": {"star.sigma_arcsec": [5.0]}})
    plainly = Campaign.from_dict(changed(star={"sigma_arcsec": 5.0}, grid=None))
    assert swept.cells[0].text == plainly.cells[0].text


def test_rows_of_another_version_are_told(tmp_path: Path, monkeypatch: Any) -> None:
    small = changed(campaign={"trials": 1})
    with monkeypatch.context() as patch:
        for module in ("_run", "_work"):
            patch.setattr(f"celestcore.campaign.{module}.package_version", lambda: "0.0.9")
        campaign.run(small, tmp_path / "o", threads=1)
    with pytest.warns(cc.CelestcoreWarning, match="also holds rows of celestcore 0.0.9"):
        campaign.run(CONFIG, tmp_path / "o")
