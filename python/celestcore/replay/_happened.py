"""What happened in a replay and when: gaps, silences, refused stretches, starts anew; in words."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from celestcore._findings import LONG_SILENCE
from celestcore._health import MANY_REJECTED, TOO_HIGH
from celestcore.replay._digest import Digest
from celestcore.replay._runs import Stretch
from celestcore.replay._tally import Tally
from celestcore.summary import spell_time
from celestcore.units import DEG_PER_HOUR

LISTED = 10
"""A stretch with fewer refused measurements is told of with others alone."""
TOGETHER = 60.0
"""Starts anew that are less far apart [s] are told of together."""
MOST = 300
CHANGED = 10.0
"""A bias is another one if it differs by more than so many sigmas."""
Event = dict[str, Any]


def events(digest: Digest) -> list[Event]:
    """Return what happened in order of time, JSON-ready; of very much only the gravest.

    Returns
    -------
    list of dict
        ``kind`` (gap, silence, refused, scattered, nis_high, restart), ``begin`` and ``end`` [s],
        ``sensor`` (None for the gyro and the filter), ``words``; ``weight`` says how grave.
    """
    found = [*_gaps(digest), *_restarts(digest)]
    for tally in digest.tallies:
        stretches = [s for s in tally.bursts.stretches(tally.usual.step) if s.rejected >= LISTED]
        found += [
            *_silences(tally, float(digest.edge[0]), float(digest.edge[-1])),
            *_refused(tally.name, stretches),
            *_windows(tally, stretches),
        ]
    gravest = sorted(found, key=lambda e: -e["weight"])[:MOST]
    return sorted(gravest, key=lambda e: (e["begin"], e["end"]))


def _event(
    kind: str, begin: float, end: float, words: str, weight: float, sensor: str | None = None
) -> Event:
    return {
        "kind": kind,
        "begin": begin,
        "end": end,
        "sensor": sensor,
        "words": words,
        "weight": float(weight),
    }


def when(begin: float, end: float) -> str:
    """Say from when to when; a tenth of a second is enough for people."""
    return f"from t = {round(begin, 1) + 0.0:,.1f} to {end:,.1f} s"


def _share(part: int, whole: int) -> str:
    return f"{100.0 * part / max(whole, 1):.3g} % of {whole:,} measurements"


def _gaps(digest: Digest) -> Iterator[Event]:
    for begin, end in digest.gaps.tolist():
        words = f"The gyro was silent for {spell_time(end - begin)}, {when(begin, end)}."
        yield _event("gap", begin, end, words, 100.0 + end - begin)


def _restarts(digest: Digest) -> Iterator[Event]:
    groups: list[list[float]] = []
    for t in digest.restarts:
        if groups and t - groups[-1][-1] < TOGETHER:
            groups[-1].append(t)
        else:
            groups.append([t])
    most = digest.note.get("options", {}).get("max_rejected")
    why = f"{most} measurements running were refused there" if most else "too much was refused"
    for group in groups:
        begin, end = group[0], group[-1]
        words = (
            f"The filter started again at t = {begin:,.1f} s: {why}."
            if len(group) == 1
            else f"The filter started again {len(group):,} times {when(begin, end)}: each time "
            f"{why}."
        )
        words += _bias_words(digest, begin, end)
        yield _event("restart", begin, end, words, 1e6 + len(group))


def _bias_words(digest: Digest, begin: float, end: float) -> str:
    """Say about which axes the gyro's bias is another one after the starts anew, if it is."""
    even = digest.even
    before = int(np.searchsorted(even["t"], begin)) - 1
    after = int(np.searchsorted(even["t"], end, side="right"))
    if before < 0 or after >= len(even["t"]):
        return ""
    out = []
    for axis in "xyz":
        old, new = (float(even[f"b{axis}"][k]) for k in (before, after))
        sigma = np.hypot(*(even[f"s_b{axis}"][k] for k in (before, after)))
        if abs(new - old) > CHANGED * sigma:
            old, new = old / DEG_PER_HOUR, new / DEG_PER_HOUR
            out.append(f"about {axis} from {old:.3g} to {new:.3g} deg/h")
    went = " and ".join(out)
    return f" At its part's end the gyro's bias had gone {went}." if out else ""


def _silences(tally: Tally, first: float, last: float) -> Iterator[Event]:
    """Yield when no measurement came at all; one that came and was refused is another matter."""
    step = tally.usual.step
    if not math.isfinite(step):
        return
    least = LONG_SILENCE * step
    seen = tally.unseen
    ends = [(first, seen.first), *seen.longer(least), (seen.last, last)]
    for begin, end in ends:
        if begin is None or end is None or end - begin <= least:
            continue
        words = f"{tally.name} gave nothing for {spell_time(end - begin)}, {when(begin, end)}."
        yield _event("silence", begin, end, words, end - begin, tally.name)


def _refused(name: str, stretches: Sequence[Stretch]) -> Iterator[Event]:
    for s in stretches:
        words = (
            f"{name} was refused {when(s.begin, s.end)}: {_share(s.rejected, s.fixes)}, over "
            f"{spell_time(s.end - s.begin)}."
        )
        yield _event("refused", s.begin, s.end, words, 1e3 + s.rejected, name)


def _windows(tally: Tally, stretches: Sequence[Stretch]) -> Iterator[Event]:
    """Yield windows of scattered refusals or a high NIS that no stretch explains."""
    seen = tally.windows
    edges = [0, *(np.flatnonzero(np.diff(seen.state)) + 1).tolist(), len(seen.state)]
    for a, b in pairwise(edges):
        state = seen.state[a]
        begin, end = float(seen.edge[a]), float(seen.edge[b])
        fixes, refused = int(seen.fixes[a:b].sum()), int(seen.rejected[a:b].sum())
        if state == MANY_REJECTED:
            inside = [s for s in stretches if s.begin < end and s.end > begin]
            if refused <= 2 * sum(s.rejected for s in inside):
                continue
            words = (
                f"{_share(refused, fixes)} of {tally.name} were refused, one here and one there, "
                f"{when(begin, end)} (as near as the health timeline tells)."
            )
            yield _event("scattered", begin, end, words, 1e3 + refused, tally.name)
        elif state == TOO_HIGH:
            mean = np.nansum(seen.ratio[a:b] * (seen.fixes - seen.rejected)[a:b])
            ratio = mean / max(fixes - refused, 1)
            words = (
                f"{tally.name} fitted badly but was believed, {when(begin, end)}: NIS per degree "
                f"of freedom {ratio:.3g}, ideal 1."
            )
            yield _event("nis_high", begin, end, words, end - begin, tally.name)
