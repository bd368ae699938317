"""The same filter one sample at a time: a loop as on board, looking ahead, saving and going on."""

from __future__ import annotations

import pickle

import celestcore as cc
import numpy as np


def main() -> None:
    log = cc.sample("fermi")
    gyro, fixes = log.gyro, log.stars["star"]
    nav = cc.StarGyroNavigator(
        filter=cc.EKF(),
        gyro=cc.Gyro(arw=3.3e-5, rrw=3.3e-8, sampling="average"),
        star=cc.StarCamera(sigma=2 * cc.ARCSEC),
        gate=0.9999,
    )
    state = nav.start(t=fixes.t[0], q=fixes.q[0], sigma0=(2 * cc.ARCSEC, 1e-5))

    # samples in order of time, as they would come in; at equal times the gyro's first
    samples, used = 900, slice(10, 900, 10)  # a fix every ten seconds
    t_fix, q_fix = fixes.t[used], fixes.q[used]
    order = np.argsort(np.concatenate([gyro.t[:samples], t_fix]), kind="stable")
    turned_away = 0
    for i in order:
        if i < samples:
            state.predict(gyro.t[i], gyro.rate[i])
        else:
            update = state.update(t_fix[i - samples], q_fix[i - samples])
            turned_away += not update.accepted
    print(f"at {state.t:.1f} s, {turned_away} of {len(t_fix)} fixes turned away")
    print(f"bias {(state.bias / cc.DEG_PER_HOUR).round(3)} deg/h")

    # a copy looks ahead and leaves the original where it is
    ahead = state.copy()
    ahead.predict(state.t + 60.0, gyro.rate[samples - 1])
    grown = ahead.sigma[:3] / cc.ARCSEC
    print(f"60 s without a fix from here: attitude sigma {grown.round(1)} arcsec")

    # a saved state goes on where it was, bit for bit
    again = pickle.loads(pickle.dumps(state))
    assert again.t == state.t
    assert np.array_equal(again.q, state.q)
    print("saved and loaded: the same state")


if __name__ == "__main__":
    main()
