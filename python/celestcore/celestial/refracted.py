"""Which stars are refracted when, and what is measured of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from celestcore._arguments import checked
from celestcore._check import FloatArray, IntArray, array, number
from celestcore.catalogue import StarCatalogue, integer
from celestcore.celestial.refraction import StarRefraction, checked_rows
from celestcore.errors import InputError
from celestcore.orbit import Trajectory
from celestcore.units import DEG

__all__ = ["RefractedStars", "refracted_stars"]

AZIMUTHS = {"fore": 0.0, "right": 90.0 * DEG, "aft": 180.0 * DEG, "left": 270.0 * DEG}


@dataclass(frozen=True, eq=False)
class RefractedStars:
    """Refracted stars along an orbit: one row for each star and epoch, epoch after epoch.

    Attributes
    ----------
    t : ndarray (m,)
        Times [s].
    epoch : ndarray (m,) of int
        Numbers of the epochs.
    row : ndarray (m,) of int
        Rows of the catalogue.
    star : ndarray (m, 3)
        Unit vectors in the catalogue, GCRS.
    r : ndarray (m, 3)
        The satellite's positions [m], GCRS.
    angle : ndarray (m,)
        True refraction in the sensor's atmosphere [rad].
    height : ndarray (m,)
        Of the rays' lowest points [m].
    occultation : ndarray (m,) of int
        Which pass of a star through the band: epoch after epoch without a gap.
    field : ndarray (m,) of int
        Number of the first field of view that sees it; 0 without fields.
    place : ndarray (m,) of int
        Number among the rows of all azimuths.
    counts : ndarray (n,) of int
        Stars at each epoch.
    sensor : StarRefraction
    pole : tuple or None
        The Earth's pole in the GCRS; None for a sphere.

    Examples
    --------
    >>> import celestcore as cc
    >>> t = np.arange(0.0, 600.0, 15.0)
    >>> orbit = cc.orbit.propagate(
    ...     cc.orbit.ForceModel.j2(), None, [7.1e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> seen = refracted_stars(orbit, cc.StarCatalogue.random(5000), StarRefraction())
    >>> bool(seen.height.min() > 20e3), len(seen.counts)
    (True, 40)
    """

    t: FloatArray
    epoch: IntArray
    row: IntArray
    star: FloatArray
    r: FloatArray
    angle: FloatArray
    height: FloatArray
    occultation: IntArray
    field: IntArray
    place: IntArray
    counts: IntArray
    sensor: StarRefraction
    pole: tuple[float, float, float] | None

    def __len__(self) -> int:
        """Return the number of rows."""
        return len(self.t)

    def __repr__(self) -> str:
        passes = len(np.unique(self.occultation))
        n, empty = len(self.counts), int((self.counts == 0).sum())
        return (
            f"RefractedStars({len(self)} refractions in {passes} passes at {n} epochs, "
            f"{empty} of them without any)"
        )

    def measured(
        self, seed: int = 0, trial: int = 0, *, density_bias: float = 0.0
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return what is measured in one trial, for ``CelestialLog(refraction=...)``.

        Each pass of a star through the band has air of one density, wrong by the sensor's
        `density_sigma`; each angle has its own error of `sigma`. An angle's errors do not depend on
        which fields of view there are.

        Parameters
        ----------
        seed : int
            Chooses the random numbers of all trials, from 0 to 2**64 - 1.
        trial : int
            Number of the trial, from 0 to 2**56 - 1.
        density_bias : float
            Relative error of the density that all passes share.

        Returns
        -------
        t, star, angle : ndarray (m,), (m, 3), (m,)
            Times [s], unit vectors, refractions [rad]. The same bits for the same seed and trial.

        Raises
        ------
        InputError
            Names the field and the value.

        Examples
        --------
        >>> import celestcore as cc
        >>> t = np.arange(0.0, 600.0, 15.0)
        >>> orbit = cc.orbit.propagate(
        ...     cc.orbit.ForceModel.j2(), None, [7.1e6, 0, 0], [0, 4e3, 6.4e3], t)
        >>> seen = refracted_stars(orbit, cc.StarCatalogue.random(5000), StarRefraction())
        >>> log = cc.CelestialLog(refraction=seen.measured(seed=1, trial=3))
        >>> len(log.refraction) == len(seen)
        True
        """
        seed = integer(seed, "seed")
        trial = integer(trial, "trial", below=1 << 56)
        bias = number(density_bias, "density_bias")
        if not abs(bias) <= 0.5:
            raise InputError("is a part of one, such as 0.01", field="density_bias", value=bias)
        angle = self.sensor.air._core.simulate(
            self.r,
            self.star,
            np.stack([self.place, self.occultation], axis=1).tolist(),
            self.pole,
            (self.sensor.sigma, self.sensor.density_sigma, bias),
            (seed, trial),
        )
        return self.t, self.star, angle


def refracted_stars(
    orbit: Trajectory,
    catalogue: StarCatalogue,
    sensor: StarRefraction | None = None,
    *,
    fields: Sequence[str | float] | None = None,
    field_of_view: tuple[float, float] = (10.0 * DEG, 10.0 * DEG),
) -> RefractedStars:
    """Find the stars of a catalogue whose light grazes the Earth on its way to a satellite.

    Parameters
    ----------
    orbit : Trajectory
        The satellite's states; its epoch says where the pole of an oblate Earth is.
    catalogue : StarCatalogue
        The stars.
    sensor : StarRefraction, optional
        Air, Earth and the band of heights; as it comes unless given.
    fields : sequence of {"fore", "aft", "left", "right"} or float, optional
        Azimuths of cameras that look at the limb, by name or in rad (0 forward, a quarter turn to
        the right of the flight). ``("aft",)`` sees stars set, ``("aft", "right")`` adds one to the
        side. None: all azimuths.
    field_of_view : (float, float)
        Full angles of a camera's rectangular field along the limb and across it [rad]; its middle
        is where a ray in the middle of the band comes from.

    Returns
    -------
    RefractedStars
        A star that two fields see stands once.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    Whether a star is in the field is decided by where it stands without refraction (0.1 degrees at
    most).

    Examples
    --------
    >>> import celestcore as cc
    >>> t = np.arange(0.0, 6000.0, 15.0)
    >>> orbit = cc.orbit.propagate(
    ...     cc.orbit.ForceModel.j2(), None, [7.1e6, 0, 0], [0, 4e3, 6.4e3], t)
    >>> sky = cc.StarCatalogue.random(5000)
    >>> everywhere, aft = (refracted_stars(orbit, sky, fields=f) for f in (None, ["aft"]))
    >>> 0 < len(aft) < len(everywhere)
    True
    """
    checked(orbit, "orbit", Trajectory)
    checked(catalogue, "catalogue", StarCatalogue)
    sensor = checked(sensor or StarRefraction(), "sensor", StarRefraction)
    if not len(orbit):
        raise InputError("is empty", field="orbit")
    checked_rows(orbit.r, catalogue.directions.copy())
    looks = _fields(fields, field_of_view)
    pole = sensor._pole(orbit.epoch, float(orbit.t[len(orbit) // 2]))
    out = sensor.air._core.sights(
        np.ascontiguousarray(orbit.state), catalogue.directions, pole, sensor.band, looks
    )
    place = np.arange(len(out["epoch"]))
    if fields is not None:
        place = place[out["field"] < len(looks)]
    columns = {name: np.asarray(column)[place] for name, column in out.items()}
    epoch = columns["epoch"]
    return RefractedStars(
        t=orbit.t[epoch],
        star=np.ascontiguousarray(catalogue.directions[columns["row"]]),
        r=np.ascontiguousarray(orbit.r[epoch]),
        place=place,
        counts=np.bincount(epoch, minlength=len(orbit)),
        sensor=sensor,
        pole=pole,
        **columns,
    )


def _fields(
    fields: Sequence[str | float] | None, field_of_view: tuple[float, float]
) -> list[tuple[float, float, float]]:
    """Return azimuth and tangents of the half angles of each field."""
    sides = array(field_of_view, "field_of_view", (2,))
    if not ((sides > 0.0) & (sides < np.pi)).all():
        raise InputError("must be between 0 and pi rad", field="field_of_view", value=sides)
    along, across = np.tan(0.5 * sides).tolist()
    if fields is None:
        return []
    if isinstance(fields, str) or not isinstance(fields, Sequence) or not fields:
        raise InputError(
            'needs a list such as ["aft", "right"], or None for all azimuths',
            field="fields",
            value=fields,
        )
    looks = []
    for field in fields:
        if isinstance(field, str):
            if field not in AZIMUTHS:
                known = ", ".join(AZIMUTHS)
                raise InputError(f"must be one of {known}, or rad", field="fields", value=field)
            azimuth = AZIMUTHS[field]
        else:
            azimuth = number(field, "fields")
        looks.append((azimuth, along, across))
    return looks
