"""What to look at next: rules over a run's figures, in plain sentences."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from celestcore._fixes import Fixes
from celestcore._health import BURST, bursts, noise, silences, white, windows
from celestcore.solution import Array
from celestcore.summary import (
    FEW_FIXES,
    MANY_TIMES,
    inside_95,
    spell_time,
    too_many_rejected,
)

TOO_SMALL, TOO_LARGE = 1.25, 0.8
"""NIS per degree of freedom above which error bars are too small, below which too large."""
UNEVEN = 1.5
"""Ratio of an axis' innovations to their prediction, over the least axis', that is too much."""
COLOURED = 0.1
"""Correlation from one innovation to the next that matters, if it is significant."""
OFFSET_ERRORS, OFFSET_SIGMA = 5.0, 0.2
"""A mean innovation matters beyond so many standard errors and so many predicted sigmas."""
LONG_SILENCE = 10.0
"""A time without fixes matters beyond so many usual steps."""
MISSING = 0.01
SOME_REJECTED = 0.01
"""Share of rejected fixes that is worth a look, if a gate rejects fewer good ones."""
SETTLING, WANDERING = 0.8, 4.0

Finding = dict[str, Any]


def finding(
    level: str,
    rule: str,
    title: str,
    words: str,
    advice: str,
    at: tuple[float, float] | None = None,
) -> Finding:
    """Return a finding as JSON has it.

    Parameters
    ----------
    level : {"act", "look", "fine"}
    rule : str
        A short name.
    title, words : str
        What was found.
    advice : str
        What it may mean, and what to do.
    at : (float, float), optional
        When [s].
    """
    return {
        "level": level,
        "rule": rule,
        "title": title,
        "words": words,
        "advice": advice,
        "at": at and list(at),
    }


def judge(fixes: Fixes, first: float, last: float) -> dict[str, Any]:
    """Return what a sensor's measurements say, JSON-ready: the ground of the rules below."""
    used = fixes.used
    nis, dof = fixes.nis[used], fixes.dof
    seen = windows(fixes, first, last)
    states = [int((seen.state == k).sum()) for k in range(6)]
    return {
        "name": fixes.name,
        "fixes": len(fixes.t),
        "accepted": int(fixes.accepted.sum()),
        "rejected": int((~fixes.accepted).sum()),
        "nis_per_dof": float(nis.mean() / dof) if len(nis) else None,
        "inside_95": float(inside_95(nis, np.full(len(nis), dof)).mean()) if len(nis) else None,
        "noise": noise(fixes),
        "noise_scale": fixes.noise_scale,
        "white": white(fixes),
        "bursts": bursts(fixes),
        "silence": silences(fixes),
        "windows": {
            "length_s": float(seen.edge[1] - seen.edge[0]),
            "all": len(seen.state),
            **dict(zip(_STATE_KEYS, states, strict=True)),
        },
    }


_STATE_KEYS = ("fine", "nis_high", "nis_low", "rejecting", "no_fixes", "few")


def of_sensors(sensors: Sequence[Mapping[str, Any]]) -> Iterator[Finding]:
    """Yield what the judged sensors give cause to look at."""
    for sensor in sensors:
        for rule in (_nothing_used, _nis, _axes, _offset, _coloured, _bursts, _silence):
            yield from rule(sensor)


def _nothing_used(s: Mapping[str, Any]) -> Iterator[Finding]:
    if s["fixes"] and not s["accepted"]:
        yield finding(
            "act",
            "none used",
            f"{s['name']}: none of {s['fixes']:,} fixes was used",
            "Every one of them was rejected.",
            "Wrong frames, a wrong mounting or the wrong sign of an axis look like that; so does "
            "a start that is far off.",
        )


def _nis(s: Mapping[str, Any]) -> Iterator[Finding]:
    ratio = s["nis_per_dof"]
    if ratio is None or s["accepted"] < FEW_FIXES or TOO_LARGE <= ratio <= TOO_SMALL:
        return
    size = math.sqrt(ratio)
    if ratio > TOO_SMALL:
        yield finding(
            "act",
            "NIS too large",
            f"{s['name']}: error bars too small (NIS per dof {ratio:.3g}, ideal 1)",
            f"Its innovations are {size:.3g} times as large as predicted{_seen(s)}.",
            "Either the fixes' noise is set too small, or that of what predicts them (for a gyro: "
            "arw, rrw), or scale, alignment or time tags are off: errors of those grow with the "
            "rate.",
        )
    else:
        yield finding(
            "look",
            "NIS too small",
            f"{s['name']}: error bars larger than needed (NIS per dof {ratio:.3g}, ideal 1)",
            f"Its innovations are only {size:.3g} times as large as predicted{_seen(s)}.",
            "The fixes' noise is set too large, or that of what predicts them. Or the fixes were "
            "smoothed before and their errors hang together: then leave the noise large.",
        )


def _seen(s: Mapping[str, Any]) -> str:
    n = s["noise"]
    if n is None or n["seen"] is None or None in n["seen"]:
        return ""
    told, seen = (" / ".join(f"{v:.3g}" for v in n[key]) for key in ("configured", "seen"))
    return f" (set: {told} {n['unit']}; the innovations fit {seen})"


def _axes(s: Mapping[str, Any]) -> Iterator[Finding]:
    n = s["noise"]
    if n is None or s["accepted"] < FEW_FIXES or None in n["ratio"]:
        return
    worst, best = max(n["ratio"]), min(n["ratio"])
    if worst < UNEVEN * best:
        return
    axis, other = n["axes"][n["ratio"].index(worst)], n["axes"][n["ratio"].index(best)]
    yield finding(
        "look",
        "axes differ",
        f"{s['name']}: its axes do not fit the noise alike",
        f"About {axis} the innovations are {worst:.3g} times their prediction, about {other} "
        f"{best:.3g} times.",
        "Give sigma one number for each axis: a camera is several times noisier about its "
        "boresight (check its mounting, too), GNSS along the vertical.",
    )


def _offset(s: Mapping[str, Any]) -> Iterator[Finding]:
    n = s["noise"]
    if n is None or s["accepted"] < FEW_FIXES:
        return
    for axis, mean, errors, predicted in zip(
        n["axes"], n["mean"], n["mean_errors"], n["predicted"], strict=True
    ):
        if errors is None or abs(errors) < OFFSET_ERRORS or abs(mean) < OFFSET_SIGMA * predicted:
            continue
        yield finding(
            "look",
            "innovations off centre",
            f"{s['name']}: innovations about {axis} are not centred on zero",
            f"The mean is {mean:.3g} {n['unit']}, {abs(errors):.0f} of its standard errors.",
            "A misalignment between sensors, a late time tag (if the body turns one way) or a bias "
            "that is held too stiffly does that.",
        )


def _coloured(s: Mapping[str, Any]) -> Iterator[Finding]:
    w = s["white"]
    if w is None or w["white"]:
        return
    largest = max((abs(v) for v in w["lag_1"] if v is not None), default=0.0)
    if largest < COLOURED:
        return
    sign = max((v for v in w["lag_1"] if v is not None), key=abs)
    cause = (
        "Errors that last from one fix to the next (smoothed fixes, thermal bending, a star field "
        "that moves slowly) or process noise that is set too small do that: the error bars hold "
        "for single fixes, not for means over many."
        if sign > 0
        else "The filter follows each fix too closely: process noise is set too large, or fix "
        "noise too small."
    )
    yield finding(
        "look",
        "not white",
        f"{s['name']}: innovations are not white",
        f"The correlation from one innovation to the next is up to {sign:.2f}, where white noise "
        "has none.",
        cause,
    )


def _bursts(s: Mapping[str, Any]) -> Iterator[Finding]:
    found = s["bursts"]
    if not found or not s["accepted"]:
        return
    top = found[0]
    count = s.get("bursts_in_all", len(found))  # of very many only the longest are listed
    many = f"{count:,} bursts" if count > 1 else "one burst"
    yield finding(
        "act" if top["fixes"] >= 4 * BURST else "look",
        "rejected bursts",
        f"{s['name']}: {many} of rejected fixes",
        f"{many.capitalize()} of {BURST} or more rejected fixes running; the longest has "
        f"{top['fixes']:,}, from t = {top['begin']:.10g} to {top['end']:.10g} s.",
        "Single rejected fixes are outliers; a burst is a sensor that was wrong for a while, or a "
        "filter that was.",
        (top["begin"], top["end"]),
    )


def _silence(s: Mapping[str, Any]) -> Iterator[Finding]:
    w = s["silence"]
    if w is None or w["end"] - w["begin"] < LONG_SILENCE * max(w["usual"], 1e-9):
        return
    length = w["end"] - w["begin"]
    yield finding(
        "look",
        "long without fixes",
        f"{s['name']}: {spell_time(length)} without a fix",
        f"From t = {w['begin']:.10g} to {w['end']:.10g} s no fix was used; usually there is one "
        f"every {spell_time(w['usual'])}.",
        "Look at what sigma grew to.",
        (w["begin"], w["end"]),
    )


def of_gaps(gaps: Array, what: str = "gyro") -> Iterator[Finding]:
    """Yield that there are gaps in the samples that carry the state along."""
    if len(gaps) == 0:
        return
    length = gaps[:, 1] - gaps[:, 0]
    k = int(length.argmax())
    number = f"{len(gaps):,} gaps" if len(gaps) > 1 else "a gap"
    yield finding(
        "look",
        "gaps",
        f"{what}: {number} in the samples",
        f"Together {spell_time(float(length.sum()))}; the longest lasts "
        f"{spell_time(float(length[k]))} from t = {gaps[k, 0]:.10g} s.",
        "The rate in a gap is not known: what is written there is a guess with its error bars.",
        (float(gaps[k, 0]), float(gaps[k, 1])),
    )


def of_restarts(
    times: Sequence[float],
    name: str = "orbit filter",
    advice: str = "A manoeuvre that the model does not know, a jump of a clock or wrong fixes do "
    "that.",
) -> Iterator[Finding]:
    """Yield that a filter lost its way and started again at some times [s]."""
    if not times:
        return
    often = f"{len(times)} times" if len(times) > 1 else "once"
    later = " and later" if len(times) > 5 else ""
    yield finding(
        "act",
        "started again",
        f"The {name} started again {often}",
        f"At t = {', '.join(f'{t:.10g}' for t in times[:5])} s{later} so many fixes running had "
        "been rejected that the filter took them for right and itself for wrong.",
        advice,
        (times[0], times[-1]),
    )


def of_bias(t: Array, bias: Array, sigma: Array, name: str = "gyro bias") -> Iterator[Finding]:
    """Yield whether a bias (n, 3) is still settling, or has left its own earlier bands."""
    n = len(t)
    if n < 8:
        return
    a, b = (3 * n) // 4, n - 1
    if t[b] <= t[a]:
        return
    falling = [k for k in range(3) if sigma[b, k] < SETTLING * sigma[a, k]]
    if falling:
        axes = ", ".join("xyz"[k] for k in falling)
        yield finding(
            "look",
            "bias not settled",
            f"The {name} has not settled",
            f"In the last quarter of the log its sigma about {axes} still fell by more than "
            f"{100 * (1 - SETTLING):.0f} %.",
            "A longer log, or the last bias and sigma as the start of the next run, gives a better "
            "one.",
            (float(t[a]), float(t[b])),
        )
    h = n // 2
    away = [k for k in range(3) if abs(bias[b, k] - bias[h, k]) > WANDERING * sigma[h, k]]
    if away:
        axes = ", ".join("xyz"[k] for k in away)
        yield finding(
            "look",
            "bias wanders",
            f"The {name} left its earlier error bars",
            f"About {axes} it ended more than {WANDERING:g} sigma from where it was half way.",
            "If that is no real change (temperature, a mode of the gyro), then the rate random "
            "walk is set too small, or scale and alignment are off.",
            (float(t[h]), float(t[b])),
        )


def of_counts(counts: Mapping[str, int], samples: str = "samples") -> Iterator[Finding]:
    """Yield what was missing, or lay outside the run."""
    missing, outside = counts.get("missing", 0), counts.get("outside", 0)
    rows = counts.get(samples, 0) + counts.get("fixes", 0)
    if missing > MISSING * max(rows, 1):
        yield finding(
            "look",
            "missing values",
            "Many missing values",
            f"{missing:,} of {rows:,} measurements were not numbers.",
            "They were left out; see what the sensor says of them.",
        )
    if outside > MISSING * max(counts.get("fixes", 0), 1):
        yield finding(
            "look",
            "outside the run",
            "Fixes outside the time of the samples",
            f"{outside:,} fixes lie before the start or after the last sample.",
            "If that was not meant, the sensors' clocks may differ.",
        )


def of_rejections(counts: Mapping[str, int], gate: float | None) -> Iterator[Finding]:
    """Yield that more was rejected than the gate rejects of good fixes: far more, or some."""
    all_of_them = counts["accepted"] + counts["rejected"]
    good = 0.0 if gate is None else 1.0 - gate
    some = max(10.0, max(SOME_REJECTED, MANY_TIMES * good) * all_of_them)
    many = too_many_rejected(dict(counts), gate)
    if counts["rejected"] > some and gate is not None and not many:
        yield finding(
            "look",
            "some rejected",
            f"{counts['rejected']:,} of {all_of_them:,} fixes were rejected",
            f"That is {100.0 * counts['rejected'] / all_of_them:.3g} %; of good fixes the gate "
            f"rejects {100.0 * good:.3g} %.",
            "If they come in stretches, look there. If they are scattered, some fixes are wrong "
            "now and then: huber or student_t weigh them instead.",
        )
    if many:
        yield finding(
            "act",
            "many rejected",
            f"{counts['rejected']:,} of {all_of_them:,} fixes were rejected",
            "The start, the noise or the frames are probably wrong.",
            "Look at the timeline: if the rejections begin at some time, look there; if they are "
            "everywhere, try a run with gate = 1 and see how large the innovations are.",
        )


def ranked(found: Sequence[Finding], *, judged: bool = True) -> list[Finding]:
    """Return findings, gravest first; without any, one that says so.

    Parameters
    ----------
    found : sequence of dict
    judged : bool
        Whether there were measurements to judge by.
    """
    order = {"act": 0, "look": 1, "fine": 2}
    out = sorted(found, key=lambda f: order[f["level"]])
    if not judged:
        out.append(
            finding(
                "look",
                "not judged",
                "Nothing to judge by",
                "No measurement was used or kept, so nothing tells whether the error bars are "
                "right.",
                "Keep the innovations, and see why no fix was used.",
            )
        )
    if out:
        return out
    words = (
        "No rule of this report found anything: NIS and rejections as expected, innovations "
        "centred and white, no gaps, the estimates settled."
    )
    return [finding("fine", "nothing", "Nothing stands out", words, "")]
