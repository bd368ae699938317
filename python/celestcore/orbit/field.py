"""Gravity fields as spherical harmonics: JGM-3, EGM2008, and ICGEM's ``.gfc`` files."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from functools import cache, lru_cache
from importlib.resources import files
from pathlib import Path

import numpy as np

from celestcore._check import FloatArray
from celestcore.errors import InputError

__all__ = ["GravityField"]

MAX_DEGREE = 70
"""The core's highest degree and order."""


@dataclass(frozen=True, eq=False)
class GravityField:
    """Coefficients of a gravity field, fully normalised.

    Attributes
    ----------
    name : str
        The model's name.
    mu : float
        Gravitational parameter [m^3/s^2].
    radius : float
        Radius that goes with the coefficients [m].
    degree : int
        Highest degree, at most 70.
    c, s : ndarray
        Cosine and sine coefficients ((degree + 1) (degree + 2) / 2,), row by row: degree n and
        order m at ``n (n + 1) / 2 + m``. Read-only.
    tide_system : str
        What C20 holds of the permanent tide: ``"zero_tide"``, ``"tide_free"``, ...

    Examples
    --------
    >>> jgm3 = GravityField.jgm3()
    >>> jgm3.degree, jgm3.tide_system, round(jgm3.j2, 10)
    (70, 'zero_tide', 0.001082636)
    """

    name: str
    mu: float
    radius: float
    degree: int
    c: FloatArray = field(repr=False)
    s: FloatArray = field(repr=False)
    tide_system: str = "unknown"

    def __post_init__(self) -> None:
        size = (self.degree + 1) * (self.degree + 2) // 2
        for what, table in (("c", self.c), ("s", self.s)):
            if table.shape != (size,):
                raise InputError(
                    f"has shape {table.shape}, needed is ({size},)", field=f"field.{what}"
                )
            table.flags.writeable = False

    @property
    def j2(self) -> float:
        """Second zonal harmonic, ``-sqrt(5) C20``."""
        return float(-np.sqrt(5.0) * self.c[3])

    @staticmethod
    def jgm3() -> GravityField:
        """Return JGM-3, 70x70, as shipped: C20 = -4.84169548456e-4, zero tide.

        Source: Tapley et al., The Joint Gravity Model 3, J. Geophys. Res. 101 (B12), 1996. mu
        is 3.986004415e14 m^3/s^2 and the radius 6378136.3 m.

        Examples
        --------
        >>> GravityField.jgm3().mu
        398600441500000.0
        """
        return _jgm3()

    @staticmethod
    def egm2008(degree: int = MAX_DEGREE) -> GravityField:
        """Return EGM2008 to a degree and order of at most 70, as shipped: tide-free.

        C20 = -4.84165143790815e-4. mu is 3.986004415e14 m^3/s^2 and the radius 6378136.3 m, the
        same as JGM-3's, whose C20 is zero tide: the tide makes 4.173e-9 of the 4.405e-9 between
        the two. At 500 km the fields pull apart by some 2e-6 m/s^2.

        Source: Pavlis et al., The development and evaluation of the Earth Gravitational Model 2008
        (EGM2008), J. Geophys. Res. 117 (B04406), 2012.

        Parameters
        ----------
        degree : int
            Highest degree to keep.

        Raises
        ------
        InputError
            If the degree is negative.

        Examples
        --------
        >>> field = GravityField.egm2008(degree=20)
        >>> field.degree, field.tide_system, round(field.j2, 10)
        (20, 'tide_free', 0.0010826262)
        """
        return _egm2008(min(int(degree), MAX_DEGREE))

    @staticmethod
    def read(path: str | Path, degree: int = MAX_DEGREE) -> GravityField:
        """Read an ICGEM ``.gfc`` file up to a degree (70 at most; more is left out).

        Terms that change with time (``gfct``) are taken at their reference epoch; their trends
        and periods are left out.

        Parameters
        ----------
        path : str or Path
            The file.
        degree : int
            Highest degree to keep.

        Raises
        ------
        InputError
            If the file is missing, not a gravity field, or not fully normalised.

        Examples
        --------
        >>> from importlib.resources import files
        >>> path = files("celestcore") / "data" / "JGM3.gfc"
        >>> GravityField.read(str(path), degree=8).degree
        8
        """
        try:
            text = Path(path).read_text(encoding="utf-8", errors="replace")
        except OSError as error:
            raise InputError(
                f"cannot be read ({error.strerror})", field="path", value=str(path)
            ) from None
        try:
            return _parse(text.splitlines(), degree)
        except InputError as error:
            raise error.located(str(path)) from None


@lru_cache(maxsize=1)
def _jgm3() -> GravityField:
    return GravityField.read(str(files("celestcore") / "data" / "JGM3.gfc"))


@cache
def _egm2008(degree: int) -> GravityField:
    return GravityField.read(str(files("celestcore") / "data" / "EGM2008.gfc"), degree)


def _number(text: str, what: str) -> float:
    try:
        return float(text.replace("D", "e").replace("d", "e"))
    except ValueError:
        raise InputError("is not a number", field=what, value=text) from None


def _header(lines: list[str]) -> tuple[dict[str, str], int]:
    found: dict[str, str] = {}
    for k, line in enumerate(lines):
        fields = line.split()
        if fields and fields[0] == "end_of_head":
            return found, k + 1
        if len(fields) >= 2:
            found.setdefault(fields[0], fields[1])
    raise InputError("has no end_of_head, so it is no ICGEM gravity field")


def _parse(lines: list[str], degree: int) -> GravityField:
    head, begin = _header(lines)
    for key in ("earth_gravity_constant", "radius", "max_degree"):
        if key not in head:
            raise InputError(f"the header lacks {key}")
    norm = head.get("norm", "fully_normalized")
    if norm != "fully_normalized":
        raise InputError("the coefficients must be fully normalised", field="norm", value=norm)
    degree = min(int(degree), int(_number(head["max_degree"], "max_degree")), MAX_DEGREE)
    if degree < 0:
        raise InputError("must be at least 0", field="degree", value=degree)
    c, s = _coefficients(lines[begin:], degree)
    return GravityField(
        name=head.get("modelname", "unknown"),
        mu=_number(head["earth_gravity_constant"], "earth_gravity_constant"),
        radius=_number(head["radius"], "radius"),
        degree=degree,
        c=c,
        s=s,
        tide_system=head.get("tide_system", "unknown"),
    )


def _coefficients(lines: Iterable[str], degree: int) -> tuple[FloatArray, FloatArray]:
    size = (degree + 1) * (degree + 2) // 2
    c, s = np.zeros(size), np.zeros(size)
    c[0] = 1.0
    for line in lines:
        fields = line.split()
        if len(fields) < 5 or fields[0] not in ("gfc", "gfct"):
            continue
        n, m = int(_number(fields[1], "degree")), int(_number(fields[2], "order"))
        if n <= degree and 0 <= m <= n:
            k = n * (n + 1) // 2 + m
            c[k], s[k] = _number(fields[3], "C"), _number(fields[4], "S")
    return c, s
