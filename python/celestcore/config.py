"""Settings: one TOML schema for ``log.toml``, sidecars of logs and ``--config`` files.

====================  ==========================================================================
table                 keys
====================  ==========================================================================
``[log]``             title, epoch, source, licence
``[frames]``          inertial, body, earth
``[gyro]``            arw, rrw, sampling, mounting, frame, max_gap_s, gap_rate_sigma
``[star]``,           sigma [rad] or sigma_arcsec, or covariance [rad^2]; mounting, frame
``[star_NAME]``
``[vector_NAME]``     sigma [rad] or sigma_deg or sigma_arcsec; mounting, frame
``[filter]``          kind (ekf, ukf, srukf, iterated, invariant, literal), integrator;
                      alpha, beta, kappa (ukf, srukf, literal)
``[gate]``            probability
``[start]``           sigma_attitude [rad] or sigma_attitude_arcsec; sigma_bias [rad/s]
====================  ==========================================================================
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import date
from typing import TYPE_CHECKING, Any

from celestcore._check import number
from celestcore._epoch import epoch_string
from celestcore._tables import table_kind
from celestcore._toml import load_toml
from celestcore.errors import InputError
from celestcore.sensors import Gyro, StarCamera, VectorSensor
from celestcore.units import ARCSEC, DEG

if TYPE_CHECKING:
    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator

__all__ = ["FRAMES", "Settings"]

FRAMES = ("inertial", "body", "earth")
"""The frames that a log names."""

_KEYS: dict[str, dict[str, str]] = {
    "log": dict.fromkeys(("title", "source", "licence"), "text") | {"epoch": "epoch"},
    "frames": dict.fromkeys(FRAMES, "text"),
    "gyro": dict.fromkeys(("arw", "rrw", "max_gap_s", "gap_rate_sigma"), "number")
    | {"sampling": "text", "mounting": "list", "frame": "text"},
    "star": dict.fromkeys(("sigma", "sigma_arcsec"), "numbers")
    | {"covariance": "list", "mounting": "list", "frame": "text"},
    "vector": dict.fromkeys(("sigma", "sigma_deg", "sigma_arcsec"), "number")
    | {"mounting": "list", "frame": "text"},
    "filter": dict.fromkeys(("alpha", "beta", "kappa"), "number")
    | {"kind": "text", "integrator": "text"},
    "gate": {"probability": "number"},
    "start": dict.fromkeys(("sigma_attitude", "sigma_attitude_arcsec", "sigma_bias"), "number"),
}
_UNITS = {"_arcsec": ARCSEC, "_deg": DEG}
_CHOICES = {
    "kind": ("ekf", "ukf", "srukf", "iterated", "invariant", "literal"),
    "integrator": ("exponential", "rk4"),
}
_SIGMA_POINT_KEYS = ("alpha", "beta", "kappa")
_SIGMA_POINT_KINDS = ("ukf", "srukf", "literal")


@dataclass(frozen=True)
class Settings:
    """Checked settings, in SI units and radians.

    Attributes
    ----------
    tables : dict of dict
        By table and key as in the TOML file; ``sigma_arcsec`` and the like have become ``sigma``.

    Examples
    --------
    >>> settings = Settings.from_dict({"gyro": {"arw": 1e-6}, "star": {"sigma_arcsec": 5}})
    >>> settings.merged({"gyro": {"rrw": 3e-9}}).gyro()
    Gyro(arw=1e-06, rrw=3e-09, sampling='hold', mounting=None, errors=None, frame='body', \
max_gap=None, gap_rate_sigma=0.001)
    """

    tables: dict[str, dict[str, Any]] = field(default_factory=dict)

    @classmethod
    def from_toml(cls, path: str | os.PathLike[str]) -> Settings:
        """Read and check a TOML file.

        Parameters
        ----------
        path : path
            The file.

        Returns
        -------
        Settings

        Raises
        ------
        InputError
            If it cannot be read or a key or value is wrong; names the file, the key, the value.

        Examples
        --------
        >>> import tempfile
        >>> from pathlib import Path
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     file = Path(folder, "mine.toml")
        ...     _ = file.write_text("gyro.arw = 1e-6")
        ...     Settings.from_toml(file).gyro().arw
        1e-06
        """
        document = load_toml(path)
        try:
            return cls.from_dict(document)
        except InputError as error:
            raise error.located(os.fspath(path)) from None

    @classmethod
    def from_dict(cls, document: Mapping[str, Any]) -> Settings:
        """Check settings given as a mapping of tables.

        Parameters
        ----------
        document : mapping of str to mapping
            Tables and their keys, as in a TOML file.

        Returns
        -------
        Settings

        Raises
        ------
        InputError
            Names the key and the value; for an unknown key the known ones.

        Examples
        --------
        >>> Settings.from_dict({"gyro": {"arw": 1e-6}, "star": {"sigma_arcsec": 5.0}}).gyro().arw
        1e-06
        """
        settings = cls({str(name): _checked(str(name), t) for name, t in document.items()})
        settings._check_values()
        return settings

    @classmethod
    def from_log(cls, log: SensorLog) -> Settings:
        """Return the settings that came with a log.

        Parameters
        ----------
        log : SensorLog
            The log.

        Returns
        -------
        Settings

        Raises
        ------
        InputError
            Names the key and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> Settings.from_log(cc.sample("fermi")).gyro().sampling
        'average'
        """
        return cls.from_dict(log.settings)

    def merged(self, over: Settings | Mapping[str, Any]) -> Settings:
        """Return these settings with those of `over` put on top, key by key.

        Noise, and another kind of filter, replace what was there whatever its unit.

        Parameters
        ----------
        over : Settings or mapping
            What goes on top.

        Returns
        -------
        Settings
            New ones; neither of both is changed.

        Raises
        ------
        InputError
            Names the key and the value.

        Examples
        --------
        >>> own = Settings.from_dict({"gyro": {"arw": 1e-6, "rrw": 1e-9}})
        >>> both = own.merged({"gyro": {"arw": 2e-6}, "filter": {"kind": "ukf"}})
        >>> both.gyro().arw, both.gyro().rrw, both.filter().kind
        (2e-06, 1e-09, 'ukf')
        """
        top = over if isinstance(over, Settings) else Settings.from_dict(over)
        tables = copy.deepcopy(self.tables)
        for name, values in top.tables.items():
            base = tables.setdefault(name, {})
            if name == "filter" and values.get("kind", base.get("kind")) != base.get("kind"):
                base.clear()
            if "sigma" in values or "covariance" in values:
                base.pop("sigma", None)
                base.pop("covariance", None)
            base.update(copy.deepcopy(values))
        merged = Settings(tables)
        merged._check_values()
        return merged

    def gyro(self) -> Gyro:
        """Return the gyro that ``[gyro]`` describes.

        Raises
        ------
        InputError
            If its angle random walk is not given.

        Examples
        --------
        >>> Settings.from_dict({"gyro": {"arw": 1e-6}}).gyro().rrw
        0.0
        """
        values = self.tables.get("gyro", {})
        if "arw" not in values:
            raise InputError(
                "the gyro's angle random walk [rad/sqrt(s)] is not given; "
                "add a line arw = ... to the table [gyro]",
                field="gyro.arw",
            )
        return _gyro(values)

    def stars(self) -> dict[str, StarCamera]:
        """Return the star cameras by table name, ``star``, ``star_1`` ...

        Examples
        --------
        >>> two = Settings.from_dict({"star_1": {"sigma": 1e-5}, "star_2": {"sigma": 2e-5}})
        >>> sorted(two.stars())
        ['star_1', 'star_2']
        """
        return {n: _star(n, v) for n, v in self.tables.items() if table_kind(n) == "star"}

    def vectors(self) -> dict[str, VectorSensor]:
        """Return the direction sensors by name, without ``vector_``.

        Raises
        ------
        InputError
            If the noise of one is not given.

        Examples
        --------
        >>> Settings.from_dict({"vector_sun": {"sigma": 1e-3}}).vectors()["sun"].sigma
        0.001
        """
        found = {n: v for n, v in self.tables.items() if table_kind(n) == "vector"}
        for name, values in found.items():
            if "sigma" not in values:
                raise InputError(
                    f"the noise is not given; add sigma_deg = ... to the table [{name}]",
                    field=f"{name}.sigma",
                )
        return {n.removeprefix("vector_"): _vector(n, v) for n, v in found.items()}

    def gate(self) -> float | None:
        """Return the probability of the chi-square gate, None for no gate.

        Examples
        --------
        >>> Settings.from_dict({"gate": {"probability": 0.999}}).gate()
        0.999
        """
        value = self.tables.get("gate", {}).get("probability")
        return None if value is None else float(value)

    def sigma0(self) -> tuple[float, float] | None:
        """Return the start's 1-sigma attitude [rad] and bias [rad/s], None if not given.

        Raises
        ------
        InputError
            If only one of both is given.

        Examples
        --------
        >>> Settings.from_dict({}).sigma0() is None
        True
        """
        values = self.tables.get("start", {})
        if not values:
            return None
        if len(values) < 2:
            raise InputError("needs both sigma_attitude_arcsec and sigma_bias", field="start")
        return float(values["sigma_attitude"]), float(values["sigma_bias"])

    def filter(self) -> Any:
        """Return the filter that ``[filter]`` describes, ``EKF()`` if there is none.

        Raises
        ------
        InputError
            Names an option that the filter does not have.

        Examples
        --------
        >>> Settings.from_dict({"filter": {"kind": "srukf"}}).filter()
        SRUKF(alpha=1.0, beta=2.0, kappa=None, integrator='exponential')
        """
        from celestcore import filters

        self._check_filter("ekf")
        options = dict(self.tables.get("filter", {}))
        kind = options.pop("kind", "ekf")
        classes = {c.kind: c for c in (getattr(filters, name) for name in filters.__all__)}
        return classes[kind](**options)

    def navigator(self) -> StarGyroNavigator:
        """Return the navigator that these settings describe.

        Raises
        ------
        InputError
            If something it needs, such as the gyro's noise, is not given.

        Examples
        --------
        >>> import celestcore as cc
        >>> log = cc.sample("fermi")
        >>> sol = Settings.from_log(log).navigator().run(log)
        """
        from celestcore.navigator import StarGyroNavigator

        stars = self.stars()
        single = not stars or list(stars) == ["star"]
        return StarGyroNavigator(
            filter=self.filter(),
            gyro=self.gyro(),
            star=stars.get("star", StarCamera()) if single else stars,
            vector=self.vectors() or None,
            gate=self.gate(),
        )

    def _check_values(self) -> None:
        """Let the sensors check their own settings, and check the rest."""
        if "gyro" in self.tables:
            _gyro({"arw": 1e-9, **self.tables["gyro"]})
        self.stars()
        for name, values in self.tables.items():
            if table_kind(name) == "vector":
                _vector(name, {"sigma": 1e-9, **values})
        for key, value in self.tables.get("start", {}).items():
            number(value, f"start.{key}", above=0.0)
        probability = self.gate()
        if probability is not None and not 0.0 < probability <= 1.0:
            raise InputError(
                "must be between 0 and 1, for example 0.9999; 1 accepts all",
                field="gate.probability",
                value=probability,
            )
        self._check_filter()

    def _check_filter(self, default: str = "") -> None:
        """Check ``[filter]``; a file may leave the kind to the one it is merged with."""
        values = self.tables.get("filter", {})
        for key, known in _CHOICES.items():
            if key in values and values[key] not in known:
                raise InputError(
                    f"must be one of {', '.join(known)}", field=f"filter.{key}", value=values[key]
                )
        kind = values.get("kind", default)
        for key in _SIGMA_POINT_KEYS if kind and kind not in _SIGMA_POINT_KINDS else ():
            if key in values:
                raise InputError(
                    "is an option of the kinds ukf, srukf and literal; set kind or remove it",
                    field=f"filter.{key}",
                    value=values[key],
                )


def _checked(name: str, values: Any) -> dict[str, Any]:
    """Check one table's keys and types and turn its units into radians."""
    kind = table_kind(name)
    kind = name if kind not in ("gyro", "star", "vector") else kind
    if kind not in _KEYS:
        known = ", ".join(k + "_NAME" if k == "vector" else k for k in _KEYS)
        raise InputError(f"unknown table; known are {known} and star_NAME", field=f"[{name}]")
    if not isinstance(values, Mapping):
        raise InputError(f"must be a table, write [{name}]", field=name, value=values)
    out: dict[str, Any] = {}
    for key, value in values.items():
        where = f"{name}.{key}"
        if key not in _KEYS[kind]:
            raise InputError(f"unknown key; known are {', '.join(_KEYS[kind])}", field=where)
        plain, value = _convert(str(key), value, where, _KEYS[kind][key])
        if plain in out:
            raise InputError(f"{plain} is given twice, in different units", field=where)
        out[plain] = value
    return out


def _convert(key: str, value: Any, where: str, what: str) -> tuple[str, Any]:
    """Return the key without its unit and the value in SI units, of the right type."""
    tolist = getattr(value, "tolist", None)
    value = tolist() if callable(tolist) else value
    single = isinstance(value, int | float) and not isinstance(value, bool)
    fits = {
        "text": isinstance(value, str),
        "number": single,
        "numbers": single or isinstance(value, list | tuple),
        "list": isinstance(value, list | tuple),
        "epoch": isinstance(value, str | date),
    }
    if not fits[what]:
        wanted = {"numbers": "a number or a list of three", "epoch": "an ISO time"}
        raise InputError(f"must be {wanted.get(what, 'a ' + what)}", field=where, value=value)
    if what == "epoch":
        return key, epoch_string(value)
    for ending, unit in _UNITS.items():
        if key.endswith(ending):
            return key.removesuffix(ending), _scaled(value, unit, where)
    return key, value


def _scaled(value: Any, unit: float, where: str) -> Any:
    if isinstance(value, list | tuple):
        return [number(v, where) * unit for v in value]
    return number(value, where) * unit


def _gyro(values: Mapping[str, Any]) -> Gyro:
    options = dict(values)
    if "max_gap_s" in options:
        options["max_gap"] = options.pop("max_gap_s")
    return Gyro(**options)


def _star(name: str, values: Mapping[str, Any]) -> StarCamera:
    try:
        return StarCamera(**values)
    except InputError as error:
        raise _renamed(error, "star", name) from None


def _vector(name: str, values: Mapping[str, Any]) -> VectorSensor:
    try:
        return VectorSensor(**values)
    except InputError as error:
        raise _renamed(error, "vector", name) from None


def _renamed(error: InputError, kind: str, name: str) -> InputError:
    if error.field is not None:
        error.field = name + error.field.removeprefix(kind)
    return error
