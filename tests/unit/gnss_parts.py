"""What the tests of replays in parts of logs with GNSS fixes share."""

from __future__ import annotations

import celestcore as cc
import numpy as np
import pytest
from celestcore.gnss import GnssStarScenario
from celestcore.orbit import ForceModel, OrbitDynamics
from celestcore.replay._source import stretches

DYNAMICS = OrbitDynamics(ForceModel.j2(), 1e-8)
SCENARIO = GnssStarScenario(force=ForceModel.j2(), duration=2400.0, lfe=())
ARM = (1.0, 0.5, -2.0)
GYRO = cc.Gyro(0.005 * cc.DEG_PER_SQRT_HOUR, 1e-9)
WINDOWS = (35.0, 430.0)


def changed(log, *, r=None, q=None, fixes=None, stars=None, gyro=None):
    """Return a log with other values, or only some of its rows."""
    gnss, star = log.gnss, log.stars["star"]
    r, q = (gnss.r if r is None else r), (star.q if q is None else q)
    keep = slice(None) if fixes is None else fixes
    seen = slice(None) if stars is None else stars
    return cc.SensorLog(
        epoch=log.epoch,
        gnss=(gnss.t[keep], r[keep], gnss.v[keep]),
        star=(star.t[seen], q[seen]),
        gyro=log.gyro if gyro is None else (log.gyro.t[gyro], log.gyro.rate[gyro]),
    )


def moved(log, begin, end, by):
    r = log.gnss.r.copy()
    r[(log.gnss.t > begin) & (log.gnss.t < end)] += by
    return changed(log, r=r)


def turned(log, begin, end=np.inf, by=0.02):
    star = log.stars["star"]
    q, late = star.q.copy(), (star.t > begin) & (star.t < end)
    q[late] = cc.quaternion.multiply(q[late], cc.quaternion.exp([0.0, by, 0.0]))
    return changed(log, q=q)


def check(found, summary, whole, every=1):
    """Hold parts against a run over the whole log: to the bit."""
    columns = whole.columns()
    assert list(found["rows"]) == list(columns)
    for name, column in columns.items():
        np.testing.assert_array_equal(found["rows"][name], column[::every], err_msg=name)
    seen, both = found["measurements"], (whole.gnss, whole.attitude)
    t = np.concatenate([m.t for m in both])
    order = np.argsort(t, kind="stable")
    for name, parts in (
        ("t", [m.t for m in both]),
        ("nis", [m.nis for m in both]),
        ("accepted", [m.accepted for m in both]),
        ("sensor", [m.kind.astype(object) for m in both]),
        ("iy", [m.innovation[:, 1] for m in both]),
        ("s_iz", [m.sigma[:, 2] for m in both]),
    ):
        np.testing.assert_array_equal(seen[name], np.concatenate(parts)[order], err_msg=name)
    assert summary.restarts == sorted([*whole.restarts, *whole.attitude_restarts])
    assert summary.fixes == len(t) == found["health"]["fixes"].sum()
    refused = sum(int((~m.accepted).sum()) for m in both)
    assert summary.rejected == refused == found["health"]["rejected"].sum()
    assert summary.log_likelihood == pytest.approx(whole.log_likelihood, rel=1e-12)


def between(t, begin, end):
    return (t < begin) | (t > end)


def windows_of(log, seconds):
    return [window.tables for window in stretches(log, seconds, -np.inf)]


class StoppedError(Exception):
    pass


def stopping(after):
    left = [after]

    def progress(_):
        left[0] -= 1
        if not left[0]:
            raise StoppedError

    return progress


def same(one, two):
    for table in ("rows", "measurements"):
        assert one[table].keys() == two[table].keys()
        for name, column in one[table].items():
            np.testing.assert_array_equal(column, two[table][name], err_msg=name)
