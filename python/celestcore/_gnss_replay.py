"""The replay of a log with GNSS fixes: what is run, and what of it is reported."""

from __future__ import annotations

import json
import math
import warnings
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._check import FloatArray, warn
from celestcore._files import replacing
from celestcore._optional import require
from celestcore._orbit_report import judged
from celestcore._tables import table_kind
from celestcore.errors import CelestcoreWarning, InputError
from celestcore.solution import package_version
from celestcore.summary import chi2_bounds
from celestcore.units import ARCSEC

if TYPE_CHECKING:
    from celestcore.analysis import NadirPointing, WithheldOrbit
    from celestcore.cli import Progress
    from celestcore.config import Settings
    from celestcore.gnss import GnssStarNavigator, GnssStarSolution
    from celestcore.log import SensorLog

WINDOWS = (60.0, 600.0)
"""Windows without fixes unless others are asked for [s]."""
ENDINGS = (".parquet", ".npz", ".csv")
UNITS = {"position": ("m", 1.0), "velocity": ("m_s", 1.0)}
"""Of innovations; those of star sensors and baselines are in arcsec."""


@dataclass(frozen=True, eq=False)
class GnssReplay:
    """A log's solution and the tests of it.

    Attributes
    ----------
    navigator : GnssStarNavigator
    solution : GnssStarSolution
        At all times of the log.
    output : GnssStarSolution
        The rows to write: the same, or at the period that was asked for.
    withheld : list of WithheldOrbit
    pointing : NadirPointing or None
    """

    navigator: GnssStarNavigator
    solution: GnssStarSolution
    output: GnssStarSolution
    withheld: list[WithheldOrbit]
    pointing: NadirPointing | None


def wanted(log: SensorLog, settings: Settings) -> bool:
    """Tell whether a log is one for the GNSS and star navigator.

    It is if it has GNSS fixes and either no gyro, or settings that describe the receiver.
    """
    return wanted_of(log.tables, settings)


def wanted_of(names: Collection[str], settings: Settings) -> bool:
    """Tell the same from the names of a log's tables."""
    return "gnss" in names and ("gyro" not in names or "gnss" in settings.tables)


def navigator_of(names: Collection[str], settings: Settings) -> GnssStarNavigator:
    """Return the navigator, and warn of what of a log's tables or the settings it does not use."""
    gyro = "gyro" in names
    nav = settings.gnss_navigator(gyro=gyro)
    if gyro and nav.gyro is None:
        warn("the gyro is not used: the settings have no table [gyro] that describes it")
    vectors = [name for name in names if table_kind(name) == "vector"]
    if vectors:
        warn(f"directions are not used together with GNSS fixes: {', '.join(vectors)}")
    if "start" in settings.tables:
        warn("the table [start] is not used: a log with GNSS fixes starts from these")
    return nav


def run(
    log: SensorLog,
    settings: Settings,
    *,
    smooth: bool = False,
    period: float | None = None,
    withhold: float | None = None,
    progress: Progress | None = None,
) -> GnssReplay:
    """Run the navigator over the log, and the tests."""
    from celestcore.analysis import nadir_pointing

    nav = navigator_of(log.tables, settings)
    go = nav.smooth if smooth else nav.run
    grid = None if period is None else _grid(log, nav, period)
    solution = go(log, progress=progress)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", CelestcoreWarning)  # the first run has said it
        output = solution if grid is None else go(log, t_output=grid)
        withheld = _withheld(nav, log, withhold)
    pointing = nadir_pointing(nav, log, solution) if log.stars else None
    return GnssReplay(nav, solution, output, withheld, pointing)


def _grid(log: SensorLog, nav: GnssStarNavigator, period: float) -> FloatArray:
    """Return the output times, from the first fix to the last."""
    if not (math.isfinite(period) and period > 0.0):
        raise InputError("must be a positive time in s", field="period", value=period)
    assert log.gnss is not None
    first, last = (float(log.gnss.t[k]) - nav.gnss.time_offset for k in (0, -1))
    return np.asarray(first + period * np.arange(int((last - first) / period + 1e-9) + 1))


def _withheld(nav: GnssStarNavigator, log: SensorLog, window: float | None) -> list[WithheldOrbit]:
    """Run the test; without a wish, over the windows for which the log is long enough."""
    from celestcore.analysis import withheld_orbit

    if window is not None:
        return [withheld_orbit(nav, log, window)]
    assert log.gnss is not None
    span = float(log.gnss.t[-1] - log.gnss.t[0])
    fitting = [each for each in WINDOWS if span >= 600.0 + 3.0 * each]
    return [withheld_orbit(nav, log, each) for each in fitting]


def summary(replay: GnssReplay, log: SensorLog, title: str | None = None) -> dict[str, Any]:
    """Return what came out; `celestcore replay --json` writes exactly this.

    Innovations and NIS are those of the measurements that were used: refused ones are counted.

    Parameters
    ----------
    replay : GnssReplay
    log : SensorLog
    title : str, optional
        What the log is called if it has no title.

    Returns
    -------
    dict
        JSON-ready: plain numbers, strings, lists; what cannot be computed is None.

        - ``log``, ``navigator``, ``filter``, ``version``, ``smoothed``, ``gate``, ``span_s``
        - ``attitude``: ``gyro``, ``kinematic`` or None
        - ``counts``: as in `GnssStarSolution`; ``restarts``: their times, s
        - ``innovations``: for each kind of measurement ``used``, ``refused``, ``rms_m``,
          ``rms_m_s`` or ``rms_arcsec`` (three axes) and ``..._total``, ``nis_mean``,
          ``nis_per_dof``, ``inside_95``
        - ``withheld``: a list of `WithheldOrbit.summary`
        - ``pointing``: `NadirPointing.summary`, or None
        - ``slow_error``: the star sensor's, body axes, arcsec; None if it is not estimated
        - ``final``: t, r, v, their sigmas, q, sigma_q, rate at the end, SI units
        - ``sensors``, ``findings``: as in `celestcore.summary.summary`, what to look at next
        - ``rows_per_second``: speed of the core
    """
    sol, nav = replay.solution, replay.navigator
    kinds = [name for name in sol.counts if f"{name}_rejected" in sol.counts]
    out = {
        "log": log.title or title,
        "navigator": "gnss-star",
        "filter": sol.filter,
        "attitude": None if sol.q is None else ("kinematic" if nav.gyro is None else "gyro"),
        "smoothed": sol.smoothed,
        "gate": nav.gate,
        "version": package_version(),
        "span_s": float(sol.t[-1] - sol.t[0]),
        "counts": sol.counts,
        "restarts": sol.restarts,
        "innovations": {name: _innovations(sol, name) for name in kinds},
        "withheld": [each.summary() for each in replay.withheld],
        "pointing": None if replay.pointing is None else replay.pointing.summary(),
        "slow_error": _slow_error(sol),
        "final": _final(sol),
        **judged(sol, log, nav),
        "rows_per_second": len(sol) / sol.elapsed_s if sol.elapsed_s > 0.0 else None,
    }
    plain: dict[str, Any] = _plain(out)
    return plain


def _innovations(sol: GnssStarSolution, kind: str) -> dict[str, Any]:
    """Return the statistics of one kind of measurement."""
    seen = sol.gnss if kind in UNITS else sol.attitude
    own = seen.kind == kind
    used = own & seen.accepted
    name, unit = UNITS.get(kind, ("arcsec", ARCSEC))
    some = bool(used.any())
    rms = (
        np.sqrt(np.mean(seen.innovation[used] ** 2, axis=0)) / unit if some else np.full(3, np.nan)
    )
    low, high = chi2_bounds(3)
    nis = seen.nis[used]
    mean = float(np.mean(nis)) if some else math.nan
    return {
        "used": int(used.sum()),
        "refused": int((own & ~seen.accepted).sum()),
        f"rms_{name}": rms,
        f"rms_total_{name}": float(np.linalg.norm(rms)),
        "nis_mean": mean,
        "nis_per_dof": mean / 3.0,
        "inside_95": float(np.mean((nis >= low) & (nis <= high))) if some else math.nan,
    }


def _slow_error(sol: GnssStarSolution) -> dict[str, Any] | None:
    if sol.lfe is None:
        return None
    return {
        name: {"value_arcsec": value / ARCSEC, "sigma_arcsec": sigma / ARCSEC, "ratio": ratio}
        for name, value, sigma, ratio in zip(
            sol.lfe.names, sol.lfe.value, sol.lfe.sigma, sol.lfe.ratio, strict=True
        )
    }


def _final(sol: GnssStarSolution) -> dict[str, Any]:
    names = ("t", "r", "v", "sigma_r", "sigma_v", "q", "sigma_q", "rate", "bias", "sigma_bias")
    found = {name: getattr(sol, name) for name in (*names, "gnss_bias", "sigma_gnss_bias")}
    return {name: array[-1] for name, array in found.items() if array is not None}


def _plain(value: Any) -> Any:
    """Return a value as JSON knows it, None for what is not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def write_solution(path: Path, solution: GnssStarSolution, log: SensorLog) -> None:
    """Write the solution's columns as .parquet, .npz or .csv; whole or not at all."""
    columns = solution.columns()
    note = {**solution.metadata(), "title": log.title}
    with replacing(path) as temporary:
        if path.suffix.lower() == ".parquet":
            arrow = require("pyarrow", extra="parquet", what="writing Parquet")
            parquet = require("pyarrow.parquet", extra="parquet", what="writing Parquet")
            text = {b"celestcore": json.dumps(note).encode()}
            table = arrow.table(columns).replace_schema_metadata(text)
            parquet.write_table(table, temporary, compression="zstd")
        elif path.suffix.lower() == ".npz":
            np.savez(temporary, **columns, note=np.array(json.dumps(note)))  # type: ignore[arg-type]
        else:
            table = np.stack(list(columns.values()), axis=1)
            np.savetxt(temporary, table, "%.17g", ",", header=",".join(columns), comments="")
