"""Two star cameras with mountings and their own times, a Sun sensor, wrong fixes, and a gate."""

from __future__ import annotations

import celestcore as cc
import numpy as np

ARW, RRW = 1.5e-6, 3e-9  # rad/sqrt(s), rad/s/sqrt(s)
CAMERA = np.array([4.0, 4.0, 30.0]) * cc.ARCSEC  # a camera is weak about its own z axis
SUN = 0.05 * cc.DEG
MOUNTING = {  # camera to body: boresights 90 degrees apart
    "star_1": cc.quaternion.exp(np.array([np.pi / 4, 0.0, 0.0])),
    "star_2": cc.quaternion.exp(np.array([-np.pi / 4, 0.0, 0.0])),
}


def simulate(seed: int) -> tuple[cc.SensorLog, np.ndarray]:
    """Return a log of all sensors and the true attitude (n, 4) at the gyro's times."""
    random = np.random.default_rng(seed)
    t = 0.1 * np.arange(6001)
    rate = np.array([2e-3, 1e-3, -1e-3])
    q = cc.quaternion.exp(rate * t[:, None])
    measured = rate + 1e-6 + ARW / np.sqrt(0.1) * random.standard_normal((len(t), 3))

    def camera(name: str, times: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        q_ic = cc.quaternion.multiply(cc.quaternion.exp(rate * times[:, None]), MOUNTING[name])
        noise = cc.quaternion.exp(CAMERA * random.standard_normal((len(times), 3)))
        return times, cc.quaternion.multiply(q_ic, noise)

    star_1 = camera("star_1", np.arange(0.0, 600.0, 0.5))
    star_2 = camera("star_2", np.arange(0.03, 600.0, 0.73))  # its own clock ticks
    wrong = random.choice(len(star_2[0]), size=20, replace=False)
    star_2[1][wrong] = cc.quaternion.multiply(
        star_2[1][wrong], cc.quaternion.exp(np.array([0.0, 5e-3, 0.0]))
    )

    t_sun = np.arange(0.0, 600.0, 1.0)
    sun_i = np.tile([0.6, 0.8, 0.0], (len(t_sun), 1))
    q_sun = cc.quaternion.exp(rate * t_sun[:, None])
    sun_b = cc.quaternion.rotate(cc.quaternion.conjugate(q_sun), sun_i)
    sun_b += SUN * random.standard_normal(sun_b.shape)
    sun_b /= np.linalg.norm(sun_b, axis=1, keepdims=True)

    log = cc.SensorLog(
        gyro=(t, measured), star_1=star_1, star_2=star_2, vector_sun=(t_sun, sun_b, sun_i)
    )
    return log, q


def main() -> None:
    log, q_true = simulate(seed=2)
    print(log)
    for gate in (None, 0.9999):
        nav = cc.StarGyroNavigator(
            filter=cc.SRUKF(),
            gyro=cc.Gyro(arw=ARW, rrw=RRW),
            star={
                name: cc.StarCamera(sigma=CAMERA, mounting=q_bc) for name, q_bc in MOUNTING.items()
            },
            vector={"sun": cc.VectorSensor(sigma=SUN)},
            gate=gate,
        )
        sol = nav.run(log)
        turn = cc.quaternion.log(cc.quaternion.multiply(cc.quaternion.conjugate(sol.q), q_true))
        rms = np.sqrt(np.mean(turn[sol.t > 60.0] ** 2, axis=0)) / cc.ARCSEC
        print(f"gate {gate}: {sol.counts['rejected']} measurements turned away")
        print(f"  attitude error {rms.round(2)} arcsec rms")
        for index, name in enumerate(sol.sensor_names):
            used = (sol.sensor == index) & sol.accepted
            per_dof = np.mean(sol.nis[used] / sol.dof[used])
            print(f"  {name}: {used.sum()} used, NIS per degree of freedom {per_dof:.2f}")


if __name__ == "__main__":
    main()
