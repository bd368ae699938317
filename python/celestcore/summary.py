"""A replay in numbers, for machines (`summary`), and in one sentence, for people (`headline`)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore.solution import Array, package_version
from celestcore.units import ARCSEC

if TYPE_CHECKING:
    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator
    from celestcore.solution import Solution


MANY_REJECTED = 0.1
"""Share of rejected fixes beyond which something other than the fixes is wrong."""
MANY_TIMES = 3.0
"""The same, as a multiple of the share that the gate rejects of good fixes."""
FEW_FIXES = 30
"""Accepted fixes below which nothing is said about the error bars."""


def summary(
    solution: Solution,
    log: SensorLog | None = None,
    *,
    gate: float | None = None,
    withheld: dict[str, Any] | None = None,
    navigator: StarGyroNavigator | None = None,
) -> dict[str, Any]:
    """Return what came out of a replay; `celestcore replay --json` writes exactly this.

    Innovations and NIS are those of the accepted measurements: the rejected ones are counted.

    Parameters
    ----------
    solution : Solution
    log : SensorLog, optional
        The log it came from: gives the title and the span.
    gate : float, optional
        Probability that the gate lets a good fix through, in (0, 1].
    withheld : dict, optional
        Summary of a withheld-window test, passed through.
    navigator : StarGyroNavigator, optional
        What ran over the log: tells the noise that each sensor was said to have.

    Returns
    -------
    dict
        JSON-ready: plain numbers, strings, lists; what cannot be computed is None.

        - ``log``, ``filter``, ``version``: title, filter and package version
        - ``smoothed``: whether every row knows the fixes after it, too
        - ``gate``: as given
        - ``counts``: samples, fixes (= accepted + rejected + start + outside), accepted,
          rejected, start (fixes that set the start), missing, gaps, outside
        - ``span_s``: time from first to last gyro sample, s
        - ``innovation``: ``rms_arcsec`` (body x, y, z), ``rms_total_arcsec``, ``nis_mean``,
          ``nis_per_dof`` (1 if the noise model is right), ``inside_95`` (fraction of NIS
          between the 2.5 % and 97.5 % chi-square quantiles; 0.95 if the noise model is right)
        - ``final``: t, q, bias, sigma at the end, SI units
        - ``samples_per_second``: speed of the core
        - ``sensors``: for each its name, counts and ``innovation`` statistics, ``noise`` (what the
          innovations say of it, axis by axis), ``noise_scale`` (what an adaptive filter had
          multiplied the variance it was told by at the end; None if it does not adapt), ``white``,
          ``bursts`` of rejected fixes, the longest ``silence`` and how many ``windows`` of the log
          were fine
        - ``findings``: what to look at next; each with ``level`` (act, look, fine), ``rule``,
          ``title``, ``words``, ``advice`` and ``at`` (begin and end in s, or None)
        - ``withheld``: as given
    """
    names = ("samples", "fixes", "accepted", "rejected", "start", "missing", "gaps", "outside")
    elapsed = solution.elapsed_s
    samples = int(solution.counts.get("samples", len(solution)))
    out: dict[str, Any] = {
        "log": solution.title or (log.title if log is not None else None),
        "filter": solution.filter,
        "smoothed": solution.smoothed,
        "gate": gate,
        "version": package_version(),
        "counts": {name: int(solution.counts.get(name, 0)) for name in names},
        "span_s": span_s(solution, log),
        "innovation": innovation(solution, solution.accepted),
        "final": {
            name: _plain(solution.final[name])
            for name in ("t", "q", "bias", "sigma")
            if name in solution.final
        },
        "samples_per_second": _plain(samples / elapsed if elapsed > 0.0 else math.nan),
    }
    out |= _judged(solution, log, gate, out["counts"], navigator)
    if withheld is not None:
        out["withheld"] = {key: _plain(value) for key, value in withheld.items()}
    return out


def _judged(
    solution: Solution,
    log: SensorLog | None,
    gate: float | None,
    counts: dict[str, int],
    navigator: StarGyroNavigator | None,
) -> dict[str, Any]:
    """Return the sensors and the findings of a summary."""
    from celestcore import _findings
    from celestcore._fixes import configured_noise, of_attitude

    told = None if navigator is None or log is None else configured_noise(navigator, log)
    t = solution.t
    first, last = (float(t[0]), float(t[-1])) if len(t) else (0.0, 0.0)
    judged = [_findings.judge(fixes, first, last) for fixes in of_attitude(solution, told)]
    sensors = [{**a, **b} for a, b in zip(per_sensor(solution), judged, strict=True)]
    found = [
        *_findings.of_rejections(counts, gate),
        *_findings.of_sensors(sensors),
        *_findings.of_gaps(solution.gaps),
        *_findings.of_bias(t, solution.bias, solution.sigma[:, 3:]),
        *_findings.of_counts(counts),
    ]
    used = any(sensor["accepted"] for sensor in sensors)
    return {"sensors": _plain(sensors), "findings": _plain(_findings.ranked(found, judged=used))}


def span_s(solution: Solution, log: SensorLog | None = None) -> float:
    """Return the time from the first to the last gyro sample (or output row), s."""
    t = log.gyro.t if log is not None and log.gyro is not None else solution.t
    return float(t[-1] - t[0]) if len(t) else 0.0


def innovation(solution: Solution, rows: NDArray[np.bool_]) -> dict[str, Any]:
    """Return the innovation statistics of some measurements, as in `summary`.

    The rms is over the star cameras (3 degrees of freedom) if there are any: the two axes of
    a direction are not body axes.
    """
    rows = rows & np.isfinite(solution.nis)
    full = rows & (solution.dof == 3)
    chosen = solution.innovation[full if full.any() else rows] / ARCSEC
    if not full.any():
        chosen = chosen[:, :2]
    rms = np.sqrt(np.mean(chosen**2, axis=0)) if len(chosen) else np.full(3, math.nan)
    nis, dof = solution.nis[rows], solution.dof[rows]
    inside = inside_95(nis, dof)
    return {
        "rms_arcsec": _plain(rms),
        "rms_total_arcsec": _plain(float(np.sqrt(np.sum(rms**2)))),
        "nis_mean": _plain(float(np.mean(nis)) if len(nis) else math.nan),
        "nis_per_dof": _plain(float(np.sum(nis) / np.sum(dof)) if len(nis) else math.nan),
        "inside_95": _plain(float(np.mean(inside)) if len(nis) else math.nan),
    }


def inside_95(nis: Array, dof: NDArray[np.integer[Any]]) -> NDArray[np.bool_]:
    """Tell which NIS lie between the 2.5 % and 97.5 % quantiles of their chi-square law."""
    inside = np.zeros(len(nis), dtype=np.bool_)
    for k in np.unique(dof):
        low, high = chi2_bounds(int(k))
        inside |= (dof == k) & (nis >= low) & (nis <= high)
    return inside


def chi2_bounds(dof: int, probability: float = 0.95) -> tuple[float, float]:
    """Return the two-sided chi-square bounds that hold the given probability."""
    from celestcore import _core

    tail = (1.0 - probability) / 2.0
    return float(_core.chi2_quantile(tail, dof)), float(_core.chi2_quantile(1.0 - tail, dof))


def per_sensor(solution: Solution) -> list[dict[str, Any]]:
    """Return name, dof, fixes, accepted, rejected and `innovation` for each sensor."""
    out = []
    for index, name in enumerate(solution.sensor_names):
        rows = solution.sensor == index
        used = rows & solution.accepted
        if rows.any():
            fixes, accepted = int(rows.sum()), int(used.sum())
            out.append(
                {
                    "name": name,
                    "dof": int(solution.dof[rows][0]),
                    "fixes": fixes,
                    "accepted": accepted,
                    "rejected": fixes - accepted,
                    **innovation(solution, used),
                }
            )
    return out


def headline(result: dict[str, Any]) -> str:
    """Return a summary's outcome in plain words: what was done, and whether to believe it."""
    counts, inn = result["counts"], result["innovation"]
    rejected, doubtful = counts["rejected"], too_many_rejected(counts, result["gate"])
    parts = [
        f"{spell_time(result['span_s']).capitalize()} with {counts['samples']:,} gyro samples and "
        f"{counts['fixes']:,} attitude fixes, "
        f"{f'{rejected:,} of them rejected' if rejected else 'none rejected'}."
    ]
    if doubtful:
        parts.insert(
            0,
            f"{rejected:,} of {counts['accepted'] + rejected:,} fixes were rejected: the start, "
            "the noise or the frames are probably wrong.",
        )
    if inn["nis_per_dof"] is None:
        used = counts["accepted"] > 0
        parts.append(
            "Innovations were not kept." if used else "No fix was used to correct the attitude."
        )
        return " ".join(parts)
    if inn["rms_total_arcsec"] is not None:
        parts.append(
            "Before each correction the prediction was off the fix by "
            f"{inn['rms_total_arcsec']:.3g} arcsec rms."
        )
    if not doubtful:
        enough = counts["accepted"] >= FEW_FIXES
        parts.append(verdict(inn) if enough else "Too few fixes were used to judge its error bars.")
    if result.get("withheld"):
        parts.append(drift_words(result["withheld"]))
    return " ".join(parts)


def too_many_rejected(counts: dict[str, int], gate: float | None = None) -> bool:
    """Tell whether far more fixes were rejected than the gate rejects of good ones."""
    rejected = counts["rejected"]
    judged = counts["accepted"] + rejected
    expected = 0.0 if gate is None else 1.0 - gate
    return judged >= 10 and rejected > max(MANY_REJECTED, MANY_TIMES * expected) * judged


def drift_words(withheld: dict[str, Any]) -> str:
    """Say in plain words how far the prediction drifted without fixes, and what it expected.

    The size of the predicted sigma is told with the share inside 3 sigma: a large enough sigma
    covers any drift.
    """
    return (
        f"With the fixes hidden for {spell_time(withheld['window_s'])} at a time, the prediction "
        f"drifted by {withheld['drift_median_arcsec']:.3g} arcsec and plain integration of the "
        f"rates by {withheld['without_bias_median_arcsec']:.3g} (medians of "
        f"{withheld['windows']} windows); estimating the bias helped in "
        f"{100.0 * withheld['nearer_with_bias']:.3g} % of them. The drift was within 3 sigma in "
        f"{100.0 * withheld['ratio_within_3']:.3g} % of them, the predicted sigma being "
        f"{withheld['sigma_median_arcsec']:.3g} arcsec."
    )


def verdict(inn: dict[str, Any]) -> str:
    """Say in plain words whether the predicted errors match the observed ones."""
    ratio, inside = inn["nis_per_dof"], 100.0 * inn["inside_95"]
    found = f"{inside:.1f} % of the fixes inside their 95 % bounds, NIS per dof {ratio:.2f}"
    if 90.0 <= inside <= 99.0 and 0.8 <= ratio <= 1.25:
        return f"Its error bars at that step can be believed ({found})."
    if ratio > 1.25:
        return f"Its error bars at that step are too small ({found})."
    if ratio < 0.8:
        return f"Its error bars at that step are larger than needed ({found})."
    return f"Its error bars are right on average, but the errors are not Gaussian ({found})."


def spell_time(seconds: float) -> str:
    """Return a duration as people say it.

    >>> spell_time(7200.0), spell_time(90.0), spell_time(1.5)
    ('2 hours', '1.5 minutes', '1.5 seconds')
    """
    for unit, size in (("days", 86400.0), ("hours", 3600.0), ("minutes", 60.0)):
        if seconds >= (2.0 if unit == "days" else 1.0) * size:
            value = f"{seconds / size:.3g}"
            return f"{value} {unit[:-1] if value == '1' else unit}"
    return f"{seconds:.3g} seconds"


def _plain(value: Any) -> Any:
    """Return a value as JSON knows it: lists, numbers, and None for what is not finite."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, np.ndarray | list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value
