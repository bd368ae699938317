"""A star camera as an instrument: stars in its field of view, centroid noise, attitude fixes.

For simulation and analysis: how many stars a camera sees and how well the attitude follows from
them. Camera frame ``c``: z along the boresight, x and y along the sides of the detector. Directions
of a catalogue are apparent ones: proper motion and aberration (20.5 arcsec by the Earth's velocity,
5 arcsec by an orbit's) are the catalogue's business and not applied here. Which star is which is
taken as known.

Examples
--------
>>> import celestcore as cc
>>> sky = StarCatalogue.random(5000, seed=1)
>>> camera = CameraModel(sky, sigma=5 * cc.ARCSEC, half_angle=10 * cc.DEG, boresight=(0, 0, -1))
>>> seen = camera.observe([0.0, 10.0], [[1.0, 0.0, 0.0, 0.0]] * 2, seed=7)
>>> seen.q.shape, seen.covariance.shape
((2, 4), (2, 3, 3))
>>> log = cc.SensorLog(star=(seen.t, seen.q, seen.covariance))
"""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from celestcore import _core
from celestcore._check import (
    QUATERNION_HINT,
    FloatArray,
    array,
    mounting,
    number,
    quaternion,
    times,
    unit_rows,
)
from celestcore.catalogue import StarCatalogue, integer
from celestcore.errors import InputError
from celestcore.quaternion import QuaternionLike, multiply, shortest_rotation, slerp
from celestcore.sensors import StarCamera
from celestcore.wahba import METHODS

__all__ = ["CameraModel", "Observations", "StarCatalogue"]

_SHAPES = ("circle", "square")
_CHANNEL = 80
"""First stream of the cameras' noise; streams below it belong to other sensors."""
_CAMERAS = 64


@dataclass(frozen=True, eq=False)
class Observations:
    """What a camera saw: frames, and the attitude fixes of those that gave one.

    Attributes
    ----------
    t : ndarray (m,)
        Times of the fixes [s].
    q : ndarray (m, 4)
        Fixes ``q_ic``, camera to inertial; without a mounting that is body to inertial.
    covariance : ndarray (m, 3, 3)
        Of the error in the camera frame [rad^2], ``q = q_hat * exp(dtheta / 2)``.
    loss : ndarray (m,)
        Wahba's loss; twice of it is chi-square with ``2 * stars - 3`` degrees of freedom.
    frame : ndarray (m,) of int
        Which frame each fix comes from.
    times : ndarray (n,)
        Times of all frames [s].
    stars : ndarray (n,) of int
        Number of stars in each frame.
    vectors : ndarray (n, k, 3)
        Measured unit vectors in the camera frame, the brightest first, padded with NaN.
    rows : ndarray (n, k) of int
        Their rows in the catalogue, padded with -1.

    Examples
    --------
    >>> camera = CameraModel(StarCatalogue.random(5000), sigma=2e-5, half_angle=0.2)
    >>> seen = camera.observe([0.0], [[1.0, 0.0, 0.0, 0.0]])
    >>> seen.vectors.shape == (1, seen.stars[0], 3)
    True
    """

    t: FloatArray
    q: FloatArray
    covariance: FloatArray
    loss: FloatArray
    frame: NDArray[np.int64]
    times: FloatArray
    stars: NDArray[np.int64]
    vectors: FloatArray
    rows: NDArray[np.int64]

    @property
    def skipped(self) -> int:
        """How many frames gave no fix: fewer than two stars, or all on one line."""
        return len(self.times) - len(self.t)

    @property
    def sigma(self) -> FloatArray:
        """1-sigma errors of the fixes about the camera's axes [rad], (m, 3)."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance, axis1=1, axis2=2)))

    def __len__(self) -> int:
        """Return the number of fixes."""
        return len(self.t)

    def __repr__(self) -> str:
        if not len(self.times):
            return "Observations(no frames)"
        return (
            f"Observations({len(self.times)} frames, {self.stars.mean():.1f} stars each, "
            f"{self.skipped} without a fix)"
        )


@dataclass(frozen=True, eq=False)
class CameraModel:
    """A star camera: a pinhole with a field of view, a magnitude limit and centroid noise.

    Parameters
    ----------
    catalogue : StarCatalogue
        The stars.
    sigma : float
        1-sigma centroid noise about each of the two axes across a star's direction [rad].
    half_angle : float
        From the boresight to the edge of the field, in a square to the middle of a side [rad],
        below pi/2.
    shape : {"circle", "square"}
        Outline of the field.
    magnitude_limit : float
        The faintest star that is seen.
    brightest : int, optional
        So many stars a frame at most, the brightest ones. None: all.
    mounting : array_like (4,) or scipy Rotation, optional
        ``q_bc``, scalar first, camera frame to body.
    boresight : array_like (3,), optional
        Short for the mounting that takes z to this direction of the body by the shortest rotation.
        Without both, the camera frame is the body frame.

    Raises
    ------
    InputError
        Names the field and the value.

    Examples
    --------
    >>> import celestcore as cc
    >>> sky = StarCatalogue.random(15_000, seed=1)
    >>> camera = CameraModel(sky, sigma=3e-5, half_angle=7 * cc.DEG, magnitude_limit=6.5)
    >>> camera.observe([0.0], [[1.0, 0.0, 0.0, 0.0]])
    Observations(1 frames, ... stars each, 0 without a fix)
    """

    catalogue: StarCatalogue
    sigma: float
    half_angle: float
    _: KW_ONLY
    shape: str = "circle"
    magnitude_limit: float = 6.0
    brightest: int | None = 20
    mounting: QuaternionLike | None = None
    boresight: ArrayLike | None = None

    def __post_init__(self) -> None:
        if not isinstance(self.catalogue, StarCatalogue):
            raise InputError("must be a StarCatalogue", field="catalogue", value=self.catalogue)
        if self.shape not in _SHAPES:
            raise InputError("must be 'circle' or 'square'", field="shape", value=self.shape)
        half = number(self.half_angle, "half_angle", above=0.0)
        if not half < np.pi / 2:
            raise InputError("must be below pi/2 rad", field="half_angle", value=half)
        values = {
            "sigma": number(self.sigma, "sigma", above=0.0),
            "half_angle": half,
            "magnitude_limit": number(self.magnitude_limit, "magnitude_limit"),
            "mounting": self._mounting(),
        }
        if self.brightest is not None:
            values["brightest"] = integer(self.brightest, "brightest", at_least=1)
        for name, value in values.items():
            object.__setattr__(self, name, value)

    def _mounting(self) -> tuple[float, ...] | None:
        if self.boresight is None:
            return mounting(self.mounting, "mounting")
        if self.mounting is not None:
            raise InputError("give mounting or boresight, not both", field="boresight")
        z = array(self.boresight, "boresight", (3,))
        return tuple(shortest_rotation([0.0, 0.0, 1.0], z).tolist())

    def sensor(self) -> StarCamera:
        """Return the `StarCamera` with this mounting, for a navigator on logs of this camera.

        Its noise is that of the log, frame by frame.

        Examples
        --------
        >>> sky = StarCatalogue.random(100)
        >>> CameraModel(sky, 1e-5, 0.1, boresight=(0.0, 0.0, -1.0)).sensor().mounting
        (0.0, 1.0, 0.0, 0.0)
        """
        return StarCamera(mounting=self.mounting)

    def observe(
        self,
        t: ArrayLike,
        q: QuaternionLike,
        *,
        times: ArrayLike | None = None,
        seed: int = 0,
        trial: int = 0,
        camera: int = 0,
        method: str = "svd",
    ) -> Observations:
        """Take frames along a true attitude and find the attitude from the stars in each.

        Parameters
        ----------
        t : array_like (k,)
            Times of the truth [s], increasing.
        q : array_like (k, 4) or scipy Rotation
            True attitudes ``q_ib``.
        times : array_like (n,), optional
            Times of the frames [s], increasing, within the truth, which is interpolated
            (`quaternion.slerp`); None: those of the truth.
        seed, trial : int
            Same seed and trial, same noise.
        camera : int
            Number of this camera on the spacecraft, 0 to 63: each has noise of its own.
        method : {"svd", "davenport", "quest"}
            See `celestcore.wahba.solve`.

        Returns
        -------
        Observations
            Frames with fewer than two stars give no fix and are counted.

        Raises
        ------
        InputError
            Names the field and the row: attitudes that are not unit quaternions, frames outside the
            truth.

        Notes
        -----
        The fixes of several cameras go into one log as ``star_1``, ``star_2``; or rotate their
        `vectors` into the body frame and solve them together with `celestcore.wahba.solve`.

        Examples
        --------
        >>> import celestcore as cc
        >>> sky = StarCatalogue.random(5000)
        >>> camera = CameraModel(sky, sigma=2e-5, half_angle=0.15)
        >>> seen = camera.observe([0.0, 1.0], [[1.0, 0, 0, 0], [0, 1.0, 0, 0]], times=[0.2, 0.7])
        >>> seen.times, len(seen) + seen.skipped
        (array([0.2, 0.7]), 2)
        """
        if method not in METHODS:
            raise InputError(f"must be one of {METHODS}", field="method", value=method)
        at, q_ib = _attitudes(t, q, times)
        q_ic = q_ib if self.mounting is None else multiply(q_ib, self.mounting)
        stars = self.catalogue
        most = len(stars) if self.brightest is None else self.brightest
        out = _core.camera_observe(
            np.ascontiguousarray(q_ic),
            stars.directions,
            stars.magnitude,
            (self.half_angle, self.magnitude_limit, self.sigma, most),
            self.shape,
            (integer(seed, "seed"), _stream(trial, camera)),
            method,
        )
        return _observations(at, out)


def _stream(trial: int, camera: int) -> int:
    trial = integer(trial, "trial", below=1 << 56)
    return trial << 8 | (_CHANNEL + integer(camera, "camera", below=_CAMERAS))


def _attitudes(
    t: ArrayLike, q: QuaternionLike, when: ArrayLike | None
) -> tuple[FloatArray, FloatArray]:
    """Return times and attitudes (n, 4) of the frames."""
    known = times(t, "t")
    truth = quaternion(q, "q")
    if truth.shape != (len(known), 4):
        raise InputError(f"has shape {truth.shape}, needed is ({len(known)}, 4)", field="q")
    bad = ~np.isfinite(truth).all(axis=1)
    if bad.any():
        raise InputError("the true attitude must be finite", field="q", row=int(np.argmax(bad)))
    unit_rows(truth, "q", what="quaternion", hint=QUATERNION_HINT)
    if when is None:
        return known, truth
    at = times(when, "times")
    outside = (at < known[0]) | (at > known[-1])
    if outside.any():
        row = int(np.argmax(outside))
        raise InputError(
            f"lies outside the truth, {float(known[0])!r} to {float(known[-1])!r} s",
            field="times",
            row=row,
            value=at[row],
        )
    if len(known) == 1:
        return at, np.repeat(truth, len(at), axis=0)
    k = np.clip(np.searchsorted(known, at, side="right") - 1, 0, len(known) - 2)
    part = (at - known[k]) / (known[k + 1] - known[k])
    return at, slerp(truth[k], truth[k + 1], part)


def _observations(at: FloatArray, out: dict[str, Any]) -> Observations:
    counts, frame = np.asarray(out["counts"]), np.asarray(out["frame"])
    most = int(counts.max(initial=0))
    filled = np.arange(most) < counts[:, None]
    vectors = np.full((len(at), most, 3), np.nan)
    vectors[filled] = out["vectors"]
    rows = np.full((len(at), most), -1, dtype=np.int64)
    rows[filled] = out["rows"]
    q = np.asarray(out["q"])
    return Observations(
        t=at[frame],
        q=np.asarray(_core.quat_continuous(q, len(q))),
        covariance=np.asarray(out["covariance"]),
        loss=np.asarray(out["loss"]),
        frame=frame,
        times=at,
        stars=counts,
        vectors=vectors,
        rows=rows,
    )
