"""Settings: one TOML schema for ``log.toml``, sidecars of logs and ``--config`` files.

====================  ==========================================================================
table                 keys
====================  ==========================================================================
``[log]``             title, epoch, source, licence
``[frames]``          inertial, body, earth
``[gyro]``            arw, rrw, sampling, mounting, frame, max_gap_s, gap_rate_sigma
``[star]``,           sigma [rad] or sigma_arcsec, or covariance [rad^2]; mounting, frame,
``[star_NAME]``       time_offset [s]
``[vector_NAME]``     sigma [rad] or sigma_deg or sigma_arcsec; mounting, frame
``[filter]``          kind (ekf, ukf, srukf, iterated, invariant, literal), integrator;
                      alpha, beta, kappa (ukf, srukf, literal)
``[gate]``            probability, huber, student_t, adaptive: how far fixes are believed
``[start]``           sigma_attitude [rad] or sigma_attitude_arcsec; sigma_bias [rad/s]
``[gnss]``            sigma [m], sigma_velocity [m/s], lever_arm [m], time_offset [s],
                      bias_sigma [m], bias_tau [s], max_rejected
``[orbit]``           gravity, field, sun, moon, drag_cd, drag_area_to_mass, srp_cr,
                      srp_area_to_mass [m^2/kg], accel_psd [m^2/s^3], max_step [s]
``[attitude]``        jerk_psd [rad^2/s^5], rate_sigma [rad/s], acceleration_sigma [rad/s^2]
``[lfe]``             amplitudes [rad] or amplitudes_arcsec, period [s], fading_sigma [rad] or
                      fading_sigma_arcsec, fading_tau [s]
====================  ==========================================================================

The last four go with GNSS fixes, as `Settings.gnss_navigator` reads them.
"""

from __future__ import annotations

import copy
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from celestcore import _gnss_settings, _settings_sensors
from celestcore._check import number
from celestcore._settings_keys import FRAMES, check_filter, checked_table
from celestcore._tables import table_kind
from celestcore._toml import load_toml
from celestcore.errors import InputError
from celestcore.sensors import Gyro, StarCamera, VectorSensor

if TYPE_CHECKING:
    from celestcore.gnss import GnssStarNavigator
    from celestcore.log import SensorLog
    from celestcore.navigator import StarGyroNavigator

__all__ = ["FRAMES", "Settings"]

WEIGHTS = ("huber", "student_t", "adaptive")
"""Keys of ``[gate]`` beside its probability, as a `StarGyroNavigator` takes them."""


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
        settings = cls({str(name): checked_table(str(name), t) for name, t in document.items()})
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
        return _settings_sensors.gyro(values)

    def stars(self) -> dict[str, StarCamera]:
        """Return the star cameras by table name, ``star``, ``star_1`` ...

        Examples
        --------
        >>> two = Settings.from_dict({"star_1": {"sigma": 1e-5}, "star_2": {"sigma": 2e-5}})
        >>> sorted(two.stars())
        ['star_1', 'star_2']
        """
        return {
            n: _settings_sensors.star(n, v)
            for n, v in self.tables.items()
            if table_kind(n) == "star"
        }

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
        return {n.removeprefix("vector_"): _settings_sensors.vector(n, v) for n, v in found.items()}

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

        check_filter(self.tables.get("filter", {}), "ekf")
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

        for name, values in self.tables.items():
            if table_kind(name) == "star" and values.get("time_offset", 0.0) != 0.0:
                raise InputError(
                    "goes with GNSS fixes; here shift the times of the log",
                    field=f"{name}.time_offset",
                    value=values["time_offset"],
                )
        stars = self.stars()
        single = not stars or list(stars) == ["star"]
        return StarGyroNavigator(
            filter=self.filter(),
            gyro=self.gyro(),
            star=stars.get("star", StarCamera()) if single else stars,
            vector=self.vectors() or None,
            gate=self.gate(),
            **{name: self.tables.get("gate", {}).get(name) for name in WEIGHTS},
        )

    def gnss_navigator(self, *, gyro: bool = False) -> GnssStarNavigator:
        """Return the navigator for GNSS and star sensors that these settings describe.

        Parameters
        ----------
        gyro : bool
            Whether the log has a gyro: then the one of ``[gyro]``, if it is described, drives the
            attitude.

        Returns
        -------
        GnssStarNavigator

        Raises
        ------
        InputError
            If the receiver's noise is not given, or the filter is none for orbits.

        Examples
        --------
        >>> settings = Settings.from_dict({"gnss": {"sigma": 1.0}, "orbit": {"accel_psd": 1e-8}})
        >>> settings.gnss_navigator().dynamics.accel_psd
        1e-08
        """
        return _gnss_settings.navigator(self, gyro=gyro)

    def _check_values(self) -> None:
        """Let the sensors check their own settings, and check the rest."""
        if "gyro" in self.tables:
            _settings_sensors.gyro({"arw": 1e-9, **self.tables["gyro"]})
        self.stars()
        _gnss_settings.check(self.tables)
        for name, values in self.tables.items():
            if table_kind(name) == "vector":
                _settings_sensors.vector(name, {"sigma": 1e-9, **values})
        for key, value in self.tables.get("start", {}).items():
            number(value, f"start.{key}", above=0.0)
        probability = self.gate()
        if probability is not None and not 0.0 < probability <= 1.0:
            raise InputError(
                "must be between 0 and 1, for example 0.9999; 1 accepts all",
                field="gate.probability",
                value=probability,
            )
        for name in WEIGHTS:
            if name in self.tables.get("gate", {}):
                number(self.tables["gate"][name], f"gate.{name}", above=0.0)
        check_filter(self.tables.get("filter", {}))
