"""What a sensor's measurements say, gathered part by part: the figures of a report in parts."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from celestcore._fixes import Fixes, Whole
from celestcore._health import (
    LAGS,
    UNUSUAL,
    Windows,
    judged_windows,
    moments,
    noise_of,
    white_of,
)
from celestcore.replay._runs import Bursts, Lags, Silences
from celestcore.replay._thin import Columns, Thinned
from celestcore.solution import Array
from celestcore.summary import inside_95
from celestcore.units import ARCSEC

INNOVATION, SIGMA = ("ix", "iy", "iz"), ("s_ix", "s_iy", "s_iz")


@dataclass(frozen=True, eq=False)
class Usual:
    """What is usual of a sensor: degrees of freedom, predicted sigmas [rad], time step [s]."""

    dof: int
    sigma: Array | None
    step: float


class Tally:
    """All of one sensor's measurements, counted and summed.

    Parameters
    ----------
    name : str
    usual : Usual
    edge : ndarray (k + 1,)
        Windows of the health timeline [s].
    buckets, even : int
        Of what is kept of a part, to be drawn.
    """

    def __init__(self, name: str, usual: Usual, edge: Array, buckets: int, even: int) -> None:
        self.name, self.usual, self.edge = name, usual, edge
        axes = usual.dof
        self.fixes = self.accepted = self.inside_95 = 0
        self.nis = 0.0
        self.inside_3 = np.zeros(axes)
        self.square = np.zeros(axes)
        self.settled, self._moments = 0, np.zeros((5, axes))
        self.lags = Lags(LAGS, axes)
        self.bursts, self.unused, self.unseen = Bursts(), Silences(), Silences()
        self._n, self._good, self._rejected = (np.zeros(len(edge) - 1, dtype=int) for _ in "ngr")
        self._total = np.zeros(len(edge) - 1)
        self._used = Thinned(self._values, buckets, even)
        self._refused = Thinned(self._values, max(buckets // 2, 1), even)
        self.configured: Array | None = None
        self.assumed: Array | None = None
        self.noise_scale: float | None = None
        self._told, self._held, self._weight = np.zeros(axes), np.zeros(axes), 0

    def _values(self, columns: Columns) -> list[Array]:
        mine = INNOVATION[: self.usual.dof] if self.usual.sigma is not None else ()
        return [columns["nis"], *(columns[name] for name in mine)]

    def tell(self, sigma: Array, fixes: int, scale: float | None = None) -> None:
        """Add the noise that the filter was told of some fixes [rad], their root mean square.

        `scale` is what an adaptive filter had multiplied its variance by at the end of these
        fixes: it stands for all of them, which holds once the filter has found it.
        """
        factor = 1.0
        if scale is not None and np.isfinite(scale):
            factor = self.noise_scale = scale
        mine = sigma[: self.usual.dof]
        if fixes and np.isfinite(mine).all():
            self._told += fixes * mine**2
            self._held += fixes * mine**2 * factor
            self._weight += fixes
            self.configured = np.sqrt(self._told / self._weight)
            self.assumed = np.sqrt(self._held / self._weight)

    def add(self, columns: Columns) -> None:
        """Add the measurements of a part, in order of time."""
        t, nis, accepted = columns["t"], columns["nis"], columns["accepted"]
        used = accepted & np.isfinite(nis)
        dof = self.usual.dof
        self.fixes += len(t)
        self.accepted += int(accepted.sum())
        self.nis += float(nis[used].sum())
        self.inside_95 += int(inside_95(nis[used], np.full(int(used.sum()), dof)).sum())
        self.bursts.add(t, accepted)
        self.unused.add(t[used])
        self.unseen.add(t)
        self._count(t, nis, used, accepted)
        if self.usual.sigma is not None:
            nu = np.stack([columns[name] for name in INNOVATION[:dof]], axis=1)
            sigma = np.stack([columns[name] for name in SIGMA[:dof]], axis=1)
            self._innovations(nu[used], sigma[used])
        for kept, rows in ((self._used, accepted), (self._refused, ~accepted)):
            kept.add({name: column[rows] for name, column in columns.items()})

    def _count(
        self, t: Array, nis: Array, used: NDArray[np.bool_], accepted: NDArray[np.bool_]
    ) -> None:
        many = len(self.edge) - 1
        at = np.clip(np.searchsorted(self.edge, t, side="right") - 1, 0, many - 1)
        self._n += np.bincount(at, minlength=many)
        self._good += np.bincount(at[used], minlength=many)
        self._rejected += np.bincount(at[~accepted], minlength=many)
        self._total += np.bincount(at[used], weights=nis[used], minlength=many)

    def _innovations(self, nu: Array, sigma: Array) -> None:
        assert self.usual.sigma is not None
        self.inside_3 += (np.abs(nu) <= 3.0 * sigma).sum(axis=0)
        self.square += np.sum(nu * nu, axis=0)
        self.lags.add(nu / sigma)
        rows = (sigma <= UNUSUAL * self.usual.sigma).all(axis=1)
        self.settled += int(rows.sum())
        self._moments += moments(nu[rows], sigma[rows])

    @property
    def windows(self) -> Windows:
        """Health over time."""
        return judged_windows(
            self.edge, self._n, self._good, self._rejected, self._total, self.usual.dof
        )

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of the innovation's axes."""
        three = self.usual.dof == 3
        return ("body x", "body y", "body z") if three else ("across 1", "across 2")

    def drawn(self) -> Fixes:
        """Return the measurements to be drawn, with what is known of all of them."""
        used, refused = self._used.columns(), self._refused.columns()
        parts = [c for c in (used, refused) if c]
        columns = {n: np.concatenate([c[n] for c in parts]) for n in parts[0]}
        order = np.argsort(columns["t"], kind="stable")
        full, dof = self.usual.sigma is not None, self.usual.dof

        def stacked(names: tuple[str, ...]) -> Array | None:
            if not full:
                return None
            return np.stack([columns[n][order] for n in names[:dof]], axis=1) / ARCSEC

        good = max(int(self._good.sum()), 1) if self.accepted else np.nan
        return Fixes(
            name=self.name,
            unit="arcsec",
            axes=self.axes,
            t=columns["t"][order],
            nis=columns["nis"][order],
            dof=dof,
            accepted=columns["accepted"][order],
            innovation=stacked(INNOVATION),
            sigma=stacked(SIGMA),
            configured=None if self.configured is None else self.configured / ARCSEC,
            noise_scale=self.noise_scale,
            whole=Whole(
                rejected=self.fixes - self.accepted,
                inside_3=tuple((self.inside_3 / good).tolist()),
                inside_95=float(self.inside_95 / good),
                windows=self.windows,
            ),
        )

    def judged(self, states: tuple[str, ...]) -> dict[str, Any]:
        """Return a sensor's entry in the summary, as `celestcore.summary.summary` has it."""
        good, dof, seen = int(self._good.sum()), self.usual.dof, self.windows
        noise, full = None, self.usual.sigma is not None and good > 0
        if self.usual.sigma is not None and self.settled:
            told, held = (
                None if sigma is None else sigma / ARCSEC
                for sigma in (self.configured, self.assumed)
            )
            unit = np.array([ARCSEC, ARCSEC**2, ARCSEC**2, 1.0, 1.0])[:, None]
            noise = noise_of(self._moments / unit, self.settled, "arcsec", self.axes, told, held)
        found = self.lags.tested()
        return {
            "name": self.name,
            "dof": dof,
            "fixes": self.fixes,
            "accepted": self.accepted,
            "rejected": self.fixes - self.accepted,
            **scores(self.square if full else None, good, self.nis, good * dof, self.inside_95),
            "noise": noise,
            "noise_scale": self.noise_scale,
            "white": None if found is None else white_of(found),
            "bursts": [
                {"begin": b.begin, "end": b.end, "fixes": b.fixes} for b in self.bursts.found()
            ],
            "bursts_in_all": self.bursts.count + (self.bursts.ends_open),
            "silence": self.unused.longest(self.usual.step),
            "windows": {
                "length_s": float(np.median(np.diff(self.edge))),
                "all": len(seen.state),
                **{name: int((seen.state == k).sum()) for k, name in enumerate(states)},
            },
        }


def scores(square: Array | None, n: int, nis: float, dof: int, inside: int) -> dict[str, Any]:
    """Return what `celestcore.summary.innovation` does, from sums over n used measurements."""
    rms = None if square is None or not n else np.sqrt(square / n) / ARCSEC
    return {
        "rms_arcsec": [None] * 3 if rms is None else rms.tolist(),
        "rms_total_arcsec": None if rms is None else float(np.sqrt(np.sum(rms**2))),
        "nis_mean": nis / n if n else None,
        "nis_per_dof": nis / dof if n else None,
        "inside_95": inside / n if n else None,
    }
