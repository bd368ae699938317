"""The published experiment with a GPS receiver and a star sensor, and variations of it."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass, fields
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from celestcore import elements, simulate
from celestcore._arguments import checked, three
from celestcore._check import BoolArray, FloatArray, array, mounting, number
from celestcore._epoch import epoch_string
from celestcore.errors import InputError
from celestcore.gnss import _noise
from celestcore.gnss._flight import Place, flights
from celestcore.gnss._noise import Outliers, Pair
from celestcore.gnss.profile import AttitudeProfile
from celestcore.log import SensorLog
from celestcore.orbit import Drag, ForceModel, GravityField, SolarPressure
from celestcore.simulate._scenario import whole
from celestcore.units import ARCSEC, DEG, DEG_PER_HOUR, DEG_PER_HOUR_PER_SQRT_HOUR
from celestcore.units import DEG_PER_SQRT_HOUR as _ROOT_HOUR

if TYPE_CHECKING:
    from celestcore.quaternion import QuaternionLike

__all__ = ["ANTENNAS", "GYRO", "ORBIT", "GnssStarScenario", "GnssStarTrial"]

ORBIT = elements.Elements(
    a=6884e3,
    e=0.0012,
    i=97.42 * DEG,
    raan=100.3 * DEG,
    argp=90.0 * DEG,
    nu=float(elements.mean_to_true(30.0 * DEG, 0.0012)),
)
"""Osculating elements at the epoch."""
GYRO = simulate.GyroErrors(
    arw=0.005 * _ROOT_HOUR,
    rrw=0.01 * DEG_PER_HOUR_PER_SQRT_HOUR,
    bias_sigma=1.0 * DEG_PER_HOUR,
)
"""The experiment's gyro, where one is used."""
ANTENNAS = ((2.0, 0.0, 0.0), (0.0, 1.5, 0.0))
"""The experiment's baselines, body frame [m], where they are used."""
PROFILE = AttitudeProfile()
"""The experiment's attitude about the orbital frame."""
_AREA_TO_MASS = 12.0 / 2650.0


def experiment_forces(gravity: GravityField | None = None) -> ForceModel:
    """Return the forces of the experiment: gravity 70x70, drag, sunlight, Sun and Moon."""
    return ForceModel(
        gravity=70,
        sun=True,
        moon=True,
        srp=SolarPressure(cr=1.3, area_to_mass=_AREA_TO_MASS),
        drag=Drag(cd=2.2, area_to_mass=_AREA_TO_MASS),
        field=GravityField.egm2008() if gravity is None else gravity,
    )


@dataclass(frozen=True, eq=False)
class GnssStarTrial:
    """One trial: what the sensors reported, and what was true.

    Attributes
    ----------
    log : SensorLog
        Tables ``gnss`` and ``star``, and ``gyro`` and ``baselines`` if there are any.
    t : ndarray (n,)
        Times of the truth [s since the epoch].
    r_i, v_i, r_e, v_e : ndarray (n, 3)
        Centre of mass, GCRS and ITRS [m], [m/s].
    q_ib, q_ob : ndarray (n, 4)
        Body to inertial and to orbital frame.
    omega_b, rate_o : ndarray (n, 3)
        Rate of the body relative to the inertial and to the orbital frame, body frame [rad/s].
    lfe : ndarray (k, 2, 3)
        Coefficients of the star sensor's low-frequency error [rad]: harmonic, cosine or sine, axis.
    star_bias : ndarray (s, 3)
        The low-frequency error, harmonics and Gauss-Markov, at the star fixes [rad].
    gnss_bias : ndarray (m, 3)
        The Gauss-Markov error of the positions at the GNSS fixes, Earth-fixed [m].
    gnss_outlier, star_outlier : ndarray of bool
        Which fixes (m,) and (s,) are outliers.
    gyro_bias : ndarray (g, 3) or None
        At the gyro's samples, body frame [rad/s].
    seed, trial : int
        What it was drawn with.

    Examples
    --------
    >>> from celestcore.orbit import ForceModel
    >>> scenario = GnssStarScenario(force=ForceModel.j2(), duration=60.0)
    >>> made = scenario.trial(seed=1)
    >>> made.log
    SensorLog(60 s from 2019-01-21T04:00:00: star 7 rows, gnss 7 rows)
    >>> made.q_ib.shape, made.lfe.shape
    ((7, 4), (2, 2, 3))
    """

    log: SensorLog
    t: FloatArray
    r_i: FloatArray
    v_i: FloatArray
    r_e: FloatArray
    v_e: FloatArray
    q_ib: FloatArray
    q_ob: FloatArray
    omega_b: FloatArray
    rate_o: FloatArray
    lfe: FloatArray
    star_bias: FloatArray
    gnss_bias: FloatArray
    gnss_outlier: BoolArray
    star_outlier: BoolArray
    gyro_bias: FloatArray | None
    seed: int
    trial: int


@dataclass(frozen=True, eq=False)
class GnssStarScenario:
    """A satellite with a GNSS receiver and a star sensor, as in the published experiment.

    The defaults are the experiment's. The orbit is flown once; attitude and errors of each trial
    have random numbers of their own for each source, so that one source changes no other.

    Parameters
    ----------
    epoch : str, datetime or astropy Time
        The time 0; UTC unless a scale follows.
    orbit : Elements
        Osculating elements then, GCRS.
    force : ForceModel, optional
        True forces; unless given, EGM2008 70x70, Harris-Priester drag (Cd 2.2, 12 m^2, 2650 kg),
        sunlight (Cr 1.3), Sun and Moon.
    gravity : GravityField, optional
        The field of those forces, instead of EGM2008.
    duration, step : float
        Length, both ends included, and spacing of the truth [s].
    attitude : AttitudeProfile
        How the body turns about the orbital frame.
    gnss_sigma : float
        White noise of positions per axis, 1-sigma [m].
    gnss_sigma_velocity : float, optional
        That of velocities [m/s]; by default a hundredth of `gnss_sigma` per second.
    gnss_velocity : bool
        Whether there are velocities.
    gnss_markov : (float, float), optional
        A first-order Gauss-Markov error of positions per Earth-fixed axis: 1-sigma [m] and
        correlation time [s].
    gnss_outliers, star_outliers : (float, float, float), optional
        Fraction of the fixes that are wrong, and by how many 1-sigmas at least and at most, in
        random directions; of GNSS fixes both position and velocity.
    lever_arm : array_like (3,)
        From the centre of mass to the GNSS antenna, body frame [m].
    gnss_step, star_step : float, optional
        Spacing of the fixes [s]; `step` unless given.
    gnss_offset, star_offset, gyro_offset : float
        A measurement with the time tag t is of ``t + offset`` [s].
    star_sigma : float or array_like (3,)
        White noise of star fixes about the sensor's axes, 1-sigma [rad].
    star_mounting : array_like (4,) or scipy Rotation, optional
        ``q_bc``, scalar first, sensor frame to body.
    lfe : sequence of float
        Low-frequency error: amplitudes of the first, second ... harmonic of the orbit's frequency
        about each axis [rad], with random phases.
    lfe_markov : (float, float), optional
        A Gauss-Markov part of it: 1-sigma [rad] and correlation time [s].
    gyro : GyroErrors, optional
        A gyro; `GYRO` is the experiment's.
    gyro_step : float
        Its sampling [s].
    baselines : array_like (k, 3), optional
        From the master antenna to others, body frame [m]; `ANTENNAS` are the experiment's. They
        come at the times of the GNSS fixes.
    baseline_sigma : float
        1-sigma of each component of a baseline [m]; half of the variance is the master's, which all
        share.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    A star fix is ``q_ib q_bc exp(e)``, with e the low-frequency error ``sum over k of c_k cos(k n
    t) + s_k sin(k n t)`` and white noise, in the sensor's frame; n is the mean motion of the
    osculating semi-major axis. An amplitude A with random phase is a prior 1-sigma of A / sqrt(2)
    for c and s.

    Random numbers are NumPy's (the gyro's are the core's): the same for the same version of NumPy.

    Examples
    --------
    >>> from celestcore.orbit import ForceModel
    >>> scenario = GnssStarScenario(force=ForceModel.j2(), gnss_sigma=10.0)
    >>> one, again = scenario.trial(seed=1, trial=7), scenario.trial(seed=1, trial=7)
    >>> len(one.t), bool((one.log.gnss.r == again.log.gnss.r).all())
    (121, True)
    """

    epoch: Any = "2019-01-21T04:00:00"
    _: KW_ONLY
    orbit: elements.Elements = ORBIT
    force: ForceModel | None = None
    gravity: GravityField | None = None
    duration: float = 1200.0
    step: float = 10.0
    attitude: AttitudeProfile = PROFILE
    gnss_sigma: float = 1.0
    gnss_sigma_velocity: float | None = None
    gnss_velocity: bool = True
    gnss_markov: Pair | None = None
    gnss_outliers: Outliers | None = None
    lever_arm: ArrayLike = (0.0, 0.0, 0.0)
    gnss_step: float | None = None
    gnss_offset: float = 0.0
    star_sigma: ArrayLike = 20.0 * ARCSEC
    star_outliers: Outliers | None = None
    star_mounting: QuaternionLike | None = None
    star_step: float | None = None
    star_offset: float = 0.0
    lfe: tuple[float, ...] = (10.0 * ARCSEC, 3.0 * ARCSEC)
    lfe_markov: Pair | None = None
    gyro: simulate.GyroErrors | None = None
    gyro_step: float = 1.0
    gyro_offset: float = 0.0
    baselines: ArrayLike | None = None
    baseline_sigma: float = 0.005

    def __post_init__(self) -> None:
        values: dict[str, Any] = {f.name: getattr(self, f.name) for f in fields(self)}
        for name, value in _checked(values).items():
            object.__setattr__(self, name, value)

    @property
    def forces(self) -> ForceModel:
        """The true forces: `force`, or the experiment's."""
        return experiment_forces(self.gravity) if self.force is None else self.force

    @property
    def velocity_sigma(self) -> float:
        """White noise of velocities per axis, 1-sigma [m/s]."""
        sigma = self.gnss_sigma_velocity
        return 0.01 * self.gnss_sigma if sigma is None else sigma

    @property
    def mean_motion(self) -> float:
        """Frequency n of the low-frequency error [rad/s]."""
        return float(elements.mean_motion(self.orbit.a, mu=self.forces.mu))

    @cached_property
    def _flight(self) -> dict[str, Place]:
        force = self.forces
        start = elements.to_state(self.orbit, mu=force.mu)
        spacings = {"truth": self.step, "gnss": self.gnss_step, "star": self.star_step}
        times = {n: _grid(self.duration, s or self.step, n) for n, s in spacings.items()}
        times["gnss"] = times["gnss"] + self.gnss_offset
        times["star"] = times["star"] + self.star_offset
        if self.gyro is not None:
            times["gyro"] = _grid(self.duration, self.gyro_step, "gyro") + self.gyro_offset
        return flights(force, self.epoch, start, times, ("truth", "gnss"))

    def trial(self, seed: int = 0, trial: int = 0) -> GnssStarTrial:
        """Return one trial.

        Parameters
        ----------
        seed : int
            Chooses the random numbers of all trials, from 0 to 2**64 - 1.
        trial : int
            Number of the trial, from 0 to 2**56 - 1.

        Returns
        -------
        GnssStarTrial
            The same for the same seed and trial, in whichever order and thread it is made.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> from celestcore.orbit import ForceModel
        >>> scenario = GnssStarScenario(force=ForceModel.j2(), gyro=GYRO, baselines=ANTENNAS)
        >>> scenario.trial(seed=1, trial=3).log
        SensorLog(1200 s from 2019-01-21T04:00:00: gyro 1201 rows, star 121 rows, gnss 121 rows,
                  baselines 121 rows)
        """
        from celestcore.gnss._trial import simulated

        return simulated(self, whole(seed, "seed", 64), whole(trial, "trial", 56))


def _grid(duration: float, step: float, name: str) -> FloatArray:
    count = np.floor(duration / step + 1e-6)
    if not 1 <= count <= 1e8:
        raise InputError(
            f"makes {count + 1:.10g} epochs of the {name}", field="duration", value=duration
        )
    return np.arange(int(count) + 1, dtype=np.float64) * step


def _checked(values: dict[str, Any]) -> dict[str, Any]:
    """Return the fields of a scenario, checked."""
    out = dict(values)
    out["epoch"] = epoch_string(values["epoch"])
    if out["epoch"] is None:
        raise InputError("is needed: Earth-fixed positions depend on it", field="epoch")
    checked(values["orbit"], "orbit", elements.Elements)
    checked(values["attitude"], "attitude", AttitudeProfile)
    for name, kind in (("force", ForceModel), ("gravity", GravityField)):
        if values[name] is not None:
            checked(values[name], name, kind)
    if values["force"] is not None and values["gravity"] is not None:
        raise InputError("goes into the force model if that is given", field="gravity")
    if values["gyro"] is not None:
        checked(values["gyro"], "gyro", simulate.GyroErrors)
    for name in ("duration", "step", "gyro_step"):
        out[name] = number(values[name], name, above=0.0)
    for name in ("gnss_step", "star_step"):
        if values[name] is not None:
            out[name] = number(values[name], name, above=0.0)
    for name in ("gnss_sigma", "baseline_sigma"):
        out[name] = number(values[name], name, at_least=0.0)
    speed = values["gnss_sigma_velocity"]
    if speed is not None:
        out["gnss_sigma_velocity"] = number(speed, "gnss_sigma_velocity", at_least=0.0)
    for name in ("gnss_offset", "star_offset", "gyro_offset"):
        out[name] = number(values[name], name)
    for name in ("gnss_markov", "lfe_markov"):
        out[name] = _noise.pair_of(values[name], name)
    for name in ("gnss_outliers", "star_outliers"):
        out[name] = _noise.outliers_of(values[name], name)
    out["star_mounting"] = mounting(values["star_mounting"], "star_mounting")
    out["lever_arm"] = tuple(three(values["lever_arm"], "lever_arm"))
    return out | _amplitudes(values)


def _amplitudes(values: dict[str, Any]) -> dict[str, Any]:
    out: dict[str, Any] = {"star_sigma": tuple(three(values["star_sigma"], "star_sigma"))}
    lfe = array(list(values["lfe"]), "lfe").reshape(-1)
    for name, given in (("star_sigma", np.array(out["star_sigma"])), ("lfe", lfe)):
        if not (np.isfinite(given).all() and (given >= 0.0).all()):
            raise InputError("must not be negative", field=name, value=given)
        if (given > 1.0).any():
            raise InputError(
                "is in radians: multiply arcseconds by celestcore.ARCSEC", field=name, value=given
            )
    out["lfe"] = tuple(lfe.tolist())
    if values["baselines"] is not None:
        b = array(values["baselines"], "baselines", (None, 3))
        if len(b) < 2 or not np.isfinite(b).all():
            raise InputError("needs two vectors at least [m]", field="baselines", value=b)
        out["baselines"] = tuple(tuple(row) for row in b.tolist())
    return out
