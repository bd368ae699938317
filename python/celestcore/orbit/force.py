"""What accelerates a satellite, composed as a value."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from celestcore import _core
from celestcore._check import FloatArray, array, number
from celestcore.errors import InputError
from celestcore.orbit.field import GravityField

__all__ = ["Drag", "ForceModel", "SolarPressure"]


@dataclass(frozen=True)
class SolarPressure:
    """Solar radiation pressure on a sphere, with the Earth's conical shadow.

    Parameters
    ----------
    cr : float
        Radiation pressure coefficient: 1 absorbs all light, 2 reflects it straight back.
    area_to_mass : float
        Cross section over mass [m^2/kg].
    pressure : float
        Pressure of sunlight at one astronomical unit [N/m^2].

    Notes
    -----
    Montenbruck and Gill, Satellite Orbits, 2000, eq. 3.75 and section 3.4.2. The shadow is that of
    a sphere of radius 6378137 m without air, with penumbra.

    Examples
    --------
    >>> SolarPressure(cr=1.3).pressure
    4.56e-06
    """

    cr: float = 1.0
    area_to_mass: float = 0.02
    pressure: float = 4.56e-6

    def __post_init__(self) -> None:
        for name in ("cr", "area_to_mass", "pressure"):
            value = number(getattr(self, name), f"srp.{name}", at_least=0.0)
            object.__setattr__(self, name, value)


@dataclass(frozen=True)
class Drag:
    """Air drag on a sphere in the Harris-Priester atmosphere, which turns with the Earth.

    Parameters
    ----------
    cd : float
        Drag coefficient.
    area_to_mass : float
        Cross section over mass [m^2/kg].
    lag : float
        How far the densest air lags the Sun [rad], 30 degrees as a rule.
    exponent : float
        Of the cosine of half the angle to the densest air: 2 at low inclinations, 6 in polar
        orbits.

    Notes
    -----
    Montenbruck and Gill, Satellite Orbits, 2000, section 3.5.2, with the standard 50 rows from 100
    to 1000 km for mean solar activity. Above 1000 km there is no air, below 100 km the lowest
    layer is carried on. Heights are geodetic (WGS 84).

    Examples
    --------
    >>> Drag(cd=2.2).exponent
    6.0
    """

    cd: float = 2.0
    area_to_mass: float = 0.02
    lag: float = float(np.pi / 6.0)
    exponent: float = 6.0

    def __post_init__(self) -> None:
        for name in ("cd", "area_to_mass"):
            object.__setattr__(
                self, name, number(getattr(self, name), f"drag.{name}", at_least=0.0)
            )
        for name in ("lag", "exponent"):
            object.__setattr__(self, name, number(getattr(self, name), f"drag.{name}"))
        if abs(self.lag) > np.pi:
            raise InputError("is in radians, not degrees", field="drag.lag", value=self.lag)
        if not 2.0 <= self.exponent <= 6.0:
            raise InputError("must be from 2 to 6", field="drag.exponent", value=self.exponent)


@dataclass(frozen=True)
class ForceModel:
    """All that accelerates a satellite.

    Parameters
    ----------
    gravity : int, (int, int), "j2" or "two-body"
        Degree (or degree and order) of the spherical harmonics, at most 70; or only the
        oblateness, about the z axis of the GCRS and so without a model of the Earth's rotation;
        or a point mass.
    sun, moon : bool
        Tides of Sun and Moon.
    srp : SolarPressure, optional
        Radiation pressure.
    drag : Drag, optional
        Air drag.
    field : GravityField, optional
        Where the coefficients come from; JGM-3 (C20 zero tide) unless given. Its mu, radius and
        C20 also serve ``"j2"`` and ``"two-body"``.

    Raises
    ------
    InputError
        If the gravity is none of these, or its degree is higher than the field's.

    Notes
    -----
    ``"j2"`` is eq. 1 of Ning and Ma 2010 with (Re/r)^2 where the print has Re/r. Solid tides,
    relativity and the Earth's albedo are not modelled.

    Examples
    --------
    >>> model = ForceModel(gravity=21, sun=True, moon=True, srp=SolarPressure(), drag=Drag())
    >>> model == ForceModel.high_fidelity(), model.needs_environment
    (True, True)
    """

    gravity: int | tuple[int, int] | Literal["j2", "two-body"] = 21
    sun: bool = False
    moon: bool = False
    srp: SolarPressure | None = None
    drag: Drag | None = None
    field: GravityField | None = None

    def __post_init__(self) -> None:
        if isinstance(self.gravity, str):
            if self.gravity not in ("j2", "two-body"):
                raise InputError(
                    "must be a degree, (degree, order), 'j2' or 'two-body'",
                    field="gravity",
                    value=self.gravity,
                )
        else:
            object.__setattr__(self, "gravity", self._degree_order())
        for name, kind in (("srp", SolarPressure), ("drag", Drag), ("field", GravityField)):
            value = getattr(self, name)
            if value is not None and not isinstance(value, kind):
                raise InputError(f"must be a {kind.__name__} or None", field=name, value=value)
        for name in ("sun", "moon"):
            object.__setattr__(self, name, bool(getattr(self, name)))

    def _degree_order(self) -> int | tuple[int, int]:
        given = array(self.gravity, "gravity").reshape(-1)
        if given.size not in (1, 2) or not (given == np.round(given)).all():
            raise InputError("must be a whole degree, or (degree, order)", field="gravity")
        degree, order = int(given[0]), int(given[-1])
        highest = self._field.degree
        if not 0 <= degree <= highest:
            raise InputError(
                f"the degree must be from 0 to {highest}", field="gravity", value=degree
            )
        if not 0 <= order <= degree:
            raise InputError("the order must be from 0 to the degree", field="gravity", value=order)
        return degree if order == degree else (degree, order)

    @property
    def _field(self) -> GravityField:
        return GravityField.jgm3() if self.field is None else self.field

    @staticmethod
    def two_body() -> ForceModel:
        """Return a point mass with JGM-3's mu.

        Examples
        --------
        >>> ForceModel.two_body().needs_environment
        False
        """
        return ForceModel(gravity="two-body")

    @staticmethod
    def j2() -> ForceModel:
        """Return a point mass with its oblateness: JGM-3's mu, radius and J2, axis GCRS z.

        Examples
        --------
        >>> ForceModel.j2().gravity
        'j2'
        """
        return ForceModel(gravity="j2")

    @staticmethod
    def high_fidelity() -> ForceModel:
        """Return JGM-3 21x21, Sun, Moon, radiation pressure and drag with their defaults.

        Examples
        --------
        >>> ForceModel.high_fidelity().gravity
        21
        """
        return ForceModel(gravity=21, sun=True, moon=True, srp=SolarPressure(), drag=Drag())

    @property
    def mu(self) -> float:
        """Gravitational parameter [m^3/s^2]."""
        return self._field.mu

    @property
    def needs_environment(self) -> bool:
        """Whether a force depends on the Earth's rotation, the Sun or the Moon."""
        closed = isinstance(self.gravity, str)
        bodies = self.sun or self.moon
        return not closed or bodies or self.srp is not None or self.drag is not None

    def _described(self) -> dict[str, Any]:
        """Return the plain numbers that the core takes."""
        field = self._field
        srp, drag = self.srp, self.drag
        out: dict[str, Any] = {
            "mu": field.mu,
            "radius": field.radius,
            "j2": field.j2,
            "sun": self.sun,
            "moon": self.moon,
            "srp": None if srp is None else (srp.cr, srp.area_to_mass, srp.pressure),
            "drag": None if drag is None else (drag.cd, drag.area_to_mass, drag.lag, drag.exponent),
        }
        if isinstance(self.gravity, str):
            return {**out, "gravity": self.gravity}
        degree, order = self.gravity if isinstance(self.gravity, tuple) else (self.gravity,) * 2
        return {
            **out,
            "gravity": "field",
            "c": field.c,
            "s": field.s,
            "degree": degree,
            "order": order,
        }

    def acceleration(
        self, t: Any, r: Any, v: Any, *, environment: dict[str, Any] | None = None
    ) -> FloatArray:
        """Return accelerations.

        Parameters
        ----------
        t : (n,) array_like
            Times [s since the environment's epoch].
        r, v : (n, 3) array_like
            Positions [m] and velocities [m/s], GCRS.
        environment : dict, optional
            Tables from `celestcore.frames.environment`; not needed for ``"j2"`` and
            ``"two-body"`` alone.

        Returns
        -------
        ndarray
            (n, 3) m/s^2, GCRS.

        Raises
        ------
        InputError
            If shapes do not fit, or tables are needed and not given.

        Examples
        --------
        >>> a = ForceModel.two_body().acceleration([0.0], [[7e6, 7e6, 0]], [[0, 0, 0]])
        >>> a.round(3).tolist()
        [[-2.876, -2.876, -0.0]]
        """
        return self._accelerations(t, r, v, environment)[0]

    def gradient(
        self, t: Any, r: Any, v: Any, *, environment: dict[str, Any] | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Return the derivatives of the acceleration to position and to velocity.

        Parameters
        ----------
        t, r, v, environment
            As `acceleration`.

        Returns
        -------
        by_position, by_velocity : ndarray
            (n, 3, 3) s^-2 and (n, 3, 3) s^-1; row i belongs to component i of the acceleration.

        Raises
        ------
        InputError
            As `acceleration`.

        Examples
        --------
        >>> g, _ = ForceModel.two_body().gradient([0.0], [[7e6, 0, 0]], [[0, 7500, 0]])
        >>> bool(abs(g[0].trace()) < 1e-20)  # gravity has no sources outside the Earth
        True
        """
        _, by_position, by_velocity = self._accelerations(t, r, v, environment)
        return by_position, by_velocity

    def _accelerations(
        self, t: Any, r: Any, v: Any, environment: dict[str, Any] | None
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        times = array(t, "t", (None,))
        state = np.hstack([array(r, "r", (times.size, 3)), array(v, "v", (times.size, 3))])
        if environment is None and self.needs_environment:
            raise InputError(
                "is needed for these forces; celestcore.frames.environment makes it",
                field="environment",
            )
        tables = environment if self.needs_environment else None
        return _core.orbit_acceleration(self._described(), tables, times, state)
