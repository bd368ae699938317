"""How a filter moves an orbit: forces, their uncertainty and the steps."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

from celestcore._check import number
from celestcore.errors import InputError
from celestcore.orbit.force import ForceModel

__all__ = ["OrbitDynamics"]

SCHEMES = ("rk4", "taylor")


@dataclass(frozen=True)
class OrbitDynamics:
    """A force model with white acceleration noise, for a navigator.

    Parameters
    ----------
    force : ForceModel
        The accelerations that are modelled.
    accel_psd : float
        Power spectral density q of those that are not, per axis [m^2/s^3]: over a step T the
        covariance grows by ``q [T^3/3, T^2/2; T^2/2, T]``. What is left out of gravity is no white
        noise; see the guide on filters and sensors for values that work.
    max_step : float
        Longest integration step [s].
    integrator : {"rk4", "taylor"}
        Classical Runge-Kutta in as many steps as needed; or one Taylor step of second order
        over the whole time, as the filter of Ning and Ma 2010 (eqs 5 and 10) takes it.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> OrbitDynamics(ForceModel.j2(), accel_psd=4e-7).max_step
    30.0
    """

    force: ForceModel
    accel_psd: float
    _: KW_ONLY
    max_step: float = 30.0
    integrator: str = "rk4"

    def __post_init__(self) -> None:
        if not isinstance(self.force, ForceModel):
            raise InputError("must be a ForceModel", field="force", value=self.force)
        for name, limit in (("accel_psd", "at_least"), ("max_step", "above")):
            value = number(getattr(self, name), name, **{limit: 0.0})
            object.__setattr__(self, name, value)
        if self.integrator not in SCHEMES:
            raise InputError(
                f"must be one of {', '.join(SCHEMES)}", field="integrator", value=self.integrator
            )

    def _described(self, tables: dict[str, Any] | None) -> dict[str, Any]:
        """Return what the core takes."""
        return {
            "forces": self.force._described(),
            "tables": tables,
            "accel_psd": self.accel_psd,
            "max_step": self.max_step,
            "scheme": self.integrator,
        }
