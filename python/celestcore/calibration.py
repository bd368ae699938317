"""What a calibration run finds: gyro errors and a camera alignment, and how well they show."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from celestcore import _core, _replay
from celestcore._check import number
from celestcore.errors import InputError
from celestcore.sensors import Gyro

if TYPE_CHECKING:
    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator
    from celestcore.solution import Solution

__all__ = ["Calibration"]

Array = NDArray[np.float64]

GYRO = tuple(
    [f"scale_{a}" for a in "xyz"]
    + [f"misalignment_{a}" for a in ("xy", "xz", "yx", "yz", "zx", "zy")]
)
ALIGNMENT = tuple(f"alignment_{a}" for a in "xyz")
_AT = ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 0), (1, 2), (2, 0), (2, 1))
SHOWN = 0.5
"""A parameter is called observable when its sigma has fallen below this part of the prior's."""


@dataclass(frozen=True, eq=False)
class Calibration:
    """Gyro and camera errors estimated from a log: what `StarGyroNavigator.calibrate` returns.

    Parameters are ``scale_x, scale_y, scale_z`` (1), ``misalignment_xy`` ... ``misalignment_zy``
    (rad; entry xy is what the x axis sees of a rate about y) and, with two cameras,
    ``alignment_x, alignment_y, alignment_z`` (rad).

    Attributes
    ----------
    value, sigma, prior_sigma : dict of str to float
        Estimate, its 1-sigma, and the 1-sigma beforehand.
    ratio : dict of str to float
        ``sigma / prior_sigma``: near 1 the log does not show the parameter, near 0 it does.
    covariance : array, (18, 18)
        Of attitude (3, rad), bias (3, rad/s), gyro errors (9) and alignment (3, rad).
    matrix : array, (3, 3)
        ``M`` in ``rate_measured = (I + M) rate + bias``, body frame.
    aligned : str or None
        The camera whose alignment was estimated.
    navigator : StarGyroNavigator
        The navigator with gyro and camera corrected, by what is observable alone.
    solution : Solution
        Attitude and bias of the calibration run.

    Examples
    --------
    >>> import celestcore as cc
    >>> log = cc.sample("fermi")
    >>> found = cc.Settings.from_log(log).navigator().calibrate(log)
    >>> sol = found.navigator.run(log)
    """

    value: dict[str, float]
    sigma: dict[str, float]
    prior_sigma: dict[str, float]
    covariance: Array
    matrix: Array
    aligned: str | None
    navigator: StarGyroNavigator
    solution: Solution

    @property
    def ratio(self) -> dict[str, float]:
        """Posterior over prior 1-sigma of each parameter."""
        return {name: self.sigma[name] / self.prior_sigma[name] for name in self.value}

    @property
    def observable(self) -> dict[str, bool]:
        """Whether the log has at least halved the 1-sigma of each parameter."""
        return {name: ratio < SHOWN for name, ratio in self.ratio.items()}

    def __str__(self) -> str:
        lines = [f"{'parameter':<18}{'value':>12}{'sigma':>11}{'prior':>11}  sigma/prior"]
        for name, ratio in self.ratio.items():
            note = "" if ratio < SHOWN else "  not observable in this log"
            lines.append(
                f"{name:<18}{self.value[name]:>12.3e}{self.sigma[name]:>11.1e}"
                f"{self.prior_sigma[name]:>11.1e}  {ratio:.3f}{note}"
            )
        return "\n".join(lines)


def calibrate(
    nav: StarGyroNavigator,
    log: SensorLog,
    prior: tuple[float, float, float],
    aligned: str | None,
    options: Mapping[str, Any],
) -> Calibration:
    """Run the calibration filter; see `StarGyroNavigator.calibrate`."""
    names = ("scale_sigma", "misalignment_sigma", "alignment_sigma")
    sigmas = [number(s, name, above=0.0) for s, name in zip(prior, names, strict=True)]
    call, sensors = _replay.prepare(nav, log, options)
    camera = _aligned(list(log.stars), aligned)
    out = _core.calibrate(call, None if camera is None else sensors.index(camera), sigmas)
    solution = _replay.finish(nav, log, sensors, call, out)
    parameters = GYRO if camera is None else GYRO + ALIGNMENT
    turn = _rotation_vector(out["alignment"])
    found = dict(zip(GYRO + ALIGNMENT, [*out["gyro_errors"], *turn], strict=True))
    sigma = np.sqrt(np.diag(out["full_covariance"]))[6:]
    prior_sigma = out["prior_sigma"]
    shown = sigma < SHOWN * prior_sigma
    return Calibration(
        value={name: float(found[name]) for name in parameters},
        sigma=dict(zip(parameters, sigma.tolist(), strict=False)),
        prior_sigma=dict(zip(parameters, prior_sigma.tolist(), strict=False)),
        covariance=out["full_covariance"],
        matrix=_matrix(out["gyro_errors"]),
        aligned=camera,
        navigator=_corrected(
            nav, _matrix(out["gyro_errors"] * shown[:9]), list(log.stars), camera, turn * shown[9:]
        ),
        solution=solution,
    )


def _aligned(cameras: list[str], name: str | None) -> str | None:
    if name is not None:
        if name not in cameras:
            raise InputError(
                f"is no star table of the log; it has {', '.join(cameras) or 'none'}",
                field="aligned",
                value=name,
            )
        if len(cameras) < 2:
            raise InputError("needs a second camera to be aligned against", field="aligned")
        return name
    if len(cameras) > 2:
        raise InputError(
            f"is needed with more than two cameras: one of {', '.join(cameras)}", field="aligned"
        )
    return cameras[1] if len(cameras) == 2 else None


def _matrix(entries: Array) -> Array:
    out = np.zeros((3, 3))
    for at, value in zip(_AT, entries, strict=True):
        out[at] = value
    return out


def _rotation_vector(q: Array) -> Array:
    from celestcore import quaternion

    return np.asarray(quaternion.log(q))


def _corrected(
    nav: StarGyroNavigator,
    matrix: Array,
    cameras: list[str],
    camera: str | None,
    turn: Array,
) -> StarGyroNavigator:
    """Return the navigator with gyro errors and a camera's rotation vector [rad] taken out."""
    gyro: Gyro = nav.gyro
    before = np.eye(3) if gyro.errors is None else np.eye(3) + np.asarray(gyro.errors)
    # the errors found come on top of those already corrected: (I + E) (I + M)
    gyro = dataclasses.replace(gyro, errors=before @ (np.eye(3) + matrix) - np.eye(3))
    star = nav.star
    if camera is not None:
        from celestcore import quaternion

        own = nav._camera(camera)
        mounting = [1.0, 0.0, 0.0, 0.0] if own.mounting is None else own.mounting
        corrected = quaternion.multiply(quaternion.exp(turn), mounting)
        turned = dataclasses.replace(own, mounting=corrected)
        star = {name: nav._camera(name) for name in cameras} | {camera: turned}
    return nav._like(gyro=gyro, star=star)
