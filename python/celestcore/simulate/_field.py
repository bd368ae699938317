"""Physical star cameras in a scenario."""

from __future__ import annotations

from dataclasses import KW_ONLY, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from celestcore._arguments import checked
from celestcore.camera import CameraModel
from celestcore.simulate._sensors import frames, schedule

if TYPE_CHECKING:
    from celestcore.sensors import StarCamera
    from celestcore.simulate._truth import Truth


@dataclass(frozen=True, eq=False)
class StarField:
    """A physical star camera and the times of its frames.

    Each frame finds the stars in view at the true attitude, moves their centroids by noise, and
    solves Wahba's problem: the fix brings a covariance of its own, which follows from its stars. A
    frame with fewer than two stars, or with all of them on one line, gives no fix. A `CameraModel`
    alone takes a frame at every sample of the truth.

    Parameters
    ----------
    camera : CameraModel
        The camera: catalogue, field of view, centroid noise [rad] and mounting ``q_bc``.
    period : float, optional
        Time from frame to frame [s].
    every : int, optional
        One frame every so many samples of the truth instead; 1 if neither is given.
    offset : float
        Where the first frame lies after the start: [s] with `period`, samples with `every`.

    Raises
    ------
    InputError
        Names the field and the value.

    Notes
    -----
    The camera at place ``k`` among those of the scenario sees, frame by frame, what
    `CameraModel.observe` sees with ``camera=k`` and the same seed and trial.

    Examples
    --------
    >>> import celestcore as cc
    >>> from celestcore import simulate
    >>> sky = cc.StarCatalogue.random(5000, seed=1)
    >>> camera = cc.CameraModel(sky, 20 * cc.ARCSEC, 8 * cc.DEG, boresight=(0.0, 0.0, -1.0))
    >>> truth, gyro = simulate.earth_pointing(60.0), simulate.GyroErrors(1e-6)
    >>> made = simulate.log(truth, gyro, simulate.StarField(camera, period=0.5), seed=1)
    >>> made.log.stars["star"].covariance.shape
    (120, 3, 3)
    """

    camera: CameraModel
    _: KW_ONLY
    period: float | None = None
    every: int | None = None
    offset: float = 0.0

    def __post_init__(self) -> None:
        checked(self.camera, "star.camera", CameraModel)
        for name, value in schedule(self.period, self.every, self.offset).items():
            object.__setattr__(self, name, value)

    def sensor(self) -> StarCamera:
        """Return the `StarCamera` with the mounting; the noise is that of the fixes.

        Examples
        --------
        >>> import celestcore as cc
        >>> camera = cc.CameraModel(cc.StarCatalogue.random(100), 1e-5, 0.1)
        >>> StarField(camera, every=5).sensor().sigma is None
        True
        """
        return self.camera.sensor()

    def _described(self, name: str, truth: Truth) -> tuple[Any, ...]:
        t, q = frames(self, truth)
        camera, stars = self.camera, self.camera.catalogue
        bright = stars.magnitude <= camera.magnitude_limit  # the others need not travel
        most = len(stars) if camera.brightest is None else camera.brightest
        optics = (camera.half_angle, camera.magnitude_limit, camera.sigma, most)
        directions = np.ascontiguousarray(stars.directions[bright])
        return (
            t,
            q,
            camera.mounting,
            (
                directions,
                stars.magnitude[bright],
                optics,
                camera.shape,
                name,
            ),
        )
