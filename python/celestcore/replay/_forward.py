"""What a replay knows of a navigator: something that takes windows and gives finished tables."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NoReturn, Protocol

import numpy as np

from celestcore._check import FloatArray
from celestcore.errors import InputError
from celestcore.replay._source import Tables


@dataclass
class Made:
    """What came of a piece."""

    tables: dict[str, dict[str, Any]]
    samples: int
    fixes: int
    rejected: int
    log_likelihood: float
    restarts: list[float] = field(default_factory=list)


class Forward(Protocol):
    """A navigator that goes over a log piece by piece: one implementation for each kind.

    What it keeps, with the rows after the time it has reached, must be all that what follows
    depends on: from there a replay goes on to the same bits.
    """

    @property
    def reached(self) -> float:
        """Time up to which all is done [s]; -inf before the start."""

    @property
    def reading_from(self) -> float:
        """Time tag before which no row of a log is needed any more [s]."""

    @property
    def late(self) -> dict[str, int]:
        """Rows that came after their time had passed, by table."""

    @property
    def options(self) -> Mapping[str, Any]:
        """The options as this navigator understands them: another job has others."""

    @property
    def described(self) -> str:
        """All of the navigator that changes results: another job has another."""

    def push(self, window: Tables) -> None:
        """Add a window."""

    def skip(self, window: Tables) -> None:
        """Add a window that had been read before a checkpoint: what is done is left out."""

    def step(self, *, last: bool) -> Made | None:
        """Go on as far as what is there allows; None if there is not enough for a row."""

    def kept(self) -> dict[str, Any] | None:
        """Return what a checkpoint keeps; None before the start."""

    def restore(self, kept: dict[str, Any] | None, late: Mapping[str, int]) -> None:
        """Go on from what a checkpoint kept."""

    def finish(self, fixes: int, rejected: int) -> None:
        """Warn of what the whole log has shown, with so many measurements seen and refused."""


@dataclass(frozen=True)
class Source:
    """What is known of a log before its first row."""

    epoch: Any
    """Where its times count from; None if it does not say."""
    names: tuple[str, ...] | None
    """Its tables; None if windows come from elsewhere."""


def refused(navigator: Any, options: Mapping[str, Any], source: Source) -> NoReturn:
    """Refuse a `CelestialNavigator`: its logs are `CelestialLog`s, which have no windows."""
    raise InputError(
        "is a CelestialNavigator, which runs over a CelestialLog in memory: call nav.run(log, r0, "
        "v0); for a longer one run over a part after the other, each from t0, r0, v0 and "
        "covariance0 = the t, r, v and covariance of the last one's sol.final",
        field="navigator",
        value=type(navigator).__name__,
    )


HEALTH = (
    "t",
    "t_end",
    "sensor",
    "fixes",
    "rejected",
    "nis_per_dof",
    "sx",
    "sy",
    "sz",
    "noise_scale",
)


def health_table(
    span: tuple[float, float],
    sensors: Mapping[str, tuple[Any, Any, Any]],
    told: Mapping[str, FloatArray] | None = None,
    scale: Mapping[str, float] | None = None,
) -> dict[str, Any]:
    """Return how each sensor fared: measurements, refused ones, mean NIS per degree of freedom.

    `sensors` has NIS, degrees of freedom and whether it was used of each measurement; `told` is
    the noise that the filter was told, along the axes of the innovations, where it is known, and
    `scale` what its variance was multiplied by at the end, if the filter adapts; else NaN.
    """
    out: dict[str, list[Any]] = {name: [] for name in HEALTH}
    for name, (nis, dof, accepted) in sensors.items():
        mean = float((nis / dof).mean()) if len(nis) else np.nan
        sigma = np.full(3, np.nan)
        known = (told or {}).get(name, sigma)
        sigma[: len(known)] = known
        found = float((scale or {}).get(name, np.nan))
        values = (*span, name, len(nis), int((~accepted).sum()), mean, *sigma.tolist(), found)
        for column, value in zip(out.values(), values, strict=True):
            column.append(value)
    return {name: np.asarray(column) for name, column in out.items()}
