"""Replay a real log: Fermi's reported rates as the gyro, its quaternions as the star camera.

Run it with ``python examples/01_replay_real_log.py``; it writes into the current folder.
"""

from __future__ import annotations

import celestcore as cc
import numpy as np


def main() -> None:
    log = cc.sample("fermi")
    print(log)

    # the log brings its noise along; only the filter and the gate are chosen here
    settings = cc.Settings.from_log(log)
    nav = settings.merged({"filter": {"kind": "ukf"}, "gate": {"probability": 0.9999}}).navigator()
    sol = nav.run(log)

    rms = np.sqrt(np.mean(sol.innovation[sol.accepted] ** 2, axis=0)) / cc.ARCSEC
    bias = sol.final["bias"] / cc.DEG_PER_HOUR
    sigma = sol.final["sigma"][3:] / cc.DEG_PER_HOUR
    print(f"{sol.counts['accepted']} of {sol.counts['fixes']} star fixes used")
    print(f"a fix differs from the prediction by {rms.round(2)} arcsec rms (x, y, z)")
    print(f"gyro bias at the end {bias.round(3)} +- {sigma.round(3)} deg/h")

    # a solution can be asked for any time, and cut by time
    middle = 0.5 * (sol.t[0] + sol.t[-1])
    print(f"attitude at {middle:.2f} s: {sol.at(middle).q.round(6)}")

    sol.to_parquet("fermi.parquet")
    sol[middle : middle + 1800.0].plot().savefig("fermi_half_an_hour.png")
    print("wrote fermi.parquet and fermi_half_an_hour.png")


if __name__ == "__main__":
    main()
