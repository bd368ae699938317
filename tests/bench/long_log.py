"""A long log on disk, day after day of the same gyro and star camera."""

from __future__ import annotations

from pathlib import Path

import celestcore as cc
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

SIGMA, ARW, RRW = 5 * cc.ARCSEC, 1e-6, 1e-10


def navigator() -> cc.StarGyroNavigator:
    """Return the filter that goes with the logs written here."""
    return cc.StarGyroNavigator(cc.EKF(), cc.Gyro(ARW, RRW), cc.StarCamera(SIGMA), gate=0.9999)


def write(folder: Path, days: int, rate: float = 10.0, day: float = 86400.0) -> None:
    """Write datasets ``gyro`` at `rate` and ``star`` at a tenth of it, a file a day.

    The spacecraft turns a whole number of times a day, so that one day's pattern, its times
    shifted, goes on where the day before ended.
    """
    rng = np.random.default_rng(7)
    n, turn = round(day * rate), 2.0 * np.pi * round(day / 5760.0) / day
    t = np.arange(n) / rate
    noise = ARW * np.sqrt(rate) * rng.standard_normal((n, 3))
    noise[:, 1] -= turn
    gyro = [values.copy() for values in noise.T]
    half = -0.5 * turn * t[::10]
    zero = np.zeros_like(half)
    q = np.stack([np.cos(half), zero, np.sin(half), zero], axis=1)
    error = cc.quaternion.exp(SIGMA * rng.standard_normal((len(half), 3)))
    star = [values.copy() for values in cc.quaternion.multiply(q, error).T]
    for table, names, columns, times in (
        ("gyro", ("wx", "wy", "wz"), gyro, t),
        ("star", ("qw", "qx", "qy", "qz"), star, t[::10]),
    ):
        (folder / table).mkdir(parents=True)
        for k in range(days):
            columns_of_day = {"t": times + k * day, **dict(zip(names, columns, strict=True))}
            pq.write_table(pa.table(columns_of_day), folder / table / f"day-{k:05d}.parquet")
