"""From stars to attitude: a camera that sees stars, Wahba's problem, and a log of what it found."""

from __future__ import annotations

import celestcore as cc
import numpy as np

RATE = np.array([0.0, -1.1e-3, 0.0])  # rad/s, about once an orbit
ARW, RRW = 1.5e-6, 3e-9  # rad/sqrt(s), rad/s/sqrt(s)


def attitude_error(truth: np.ndarray, estimate: np.ndarray) -> np.ndarray:
    """Return the rotation vectors (n, 3) from estimate to truth, body frame, rad."""
    return cc.quaternion.log(cc.quaternion.multiply(cc.quaternion.conjugate(estimate), truth))


def main() -> None:
    # a sky that is made up, and a camera of 16 degrees that looks away from the Earth (-z)
    sky = cc.StarCatalogue.random(15_000, seed=1)
    camera = cc.CameraModel(
        sky,
        sigma=10 * cc.ARCSEC,  # of each star, in each of two axes
        half_angle=8 * cc.DEG,
        shape="square",
        magnitude_limit=5.5,
        brightest=15,
        boresight=(0.0, 0.0, -1.0),
    )
    t = np.arange(0.0, 600.0, 0.1)
    q = cc.quaternion.exp(RATE * t[:, None])
    seen = camera.observe(t, q, times=t[::5], seed=1)
    print(seen)
    around = (np.median(seen.sigma, axis=0) / cc.ARCSEC).round(1)
    print(f"median sigma about the camera's axes {around} arcsec: weak about the boresight")

    # the same fixes by hand: the stars of each frame, as the camera and as the catalogue has them
    stars = np.where(seen.rows[..., None] < 0, np.nan, sky.directions[seen.rows])
    for method in cc.wahba.METHODS:
        fix = cc.wahba.solve(seen.vectors, stars, sigma=camera.sigma, method=method)
        same = cc.quaternion.angle_between(fix.q, seen.q).max()
        print(f"{method}: all frames within {same / cc.ARCSEC:.0e} arcsec of the camera's own fix")

    # a frame of one star, or of stars on one line, is an error that names the free axis
    try:
        cc.wahba.solve(seen.vectors[0, :1], stars[0, :1], sigma=camera.sigma)
    except cc.InputError as error:
        print(f"one star: {error}")

    # each fix brings its own covariance into the log; a gyro bridges and averages
    random = np.random.default_rng(1)
    rates = RATE + 1e-5 + ARW / np.sqrt(0.1) * random.standard_normal((len(t), 3))
    log = cc.SensorLog(gyro=(t, rates), star=(seen.t, seen.q, seen.covariance))
    nav = cc.StarGyroNavigator(cc.UKF(), cc.Gyro(arw=ARW, rrw=RRW), star=camera.sensor())
    sol = nav.run(log)

    settled = sol.t > 60.0
    raw = cc.quaternion.multiply(seen.q, cc.quaternion.conjugate(camera.mounting))
    for name, truth, estimate in (("fixes", q[::5], raw), ("filter", q[settled], sol.q[settled])):
        rms = np.sqrt(np.mean(attitude_error(truth, estimate) ** 2, axis=0)) / cc.ARCSEC
        print(f"{name}: {rms.round(2)} arcsec rms about x, y, z")


if __name__ == "__main__":
    main()
