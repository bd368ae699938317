"""A flight on which everything breaks once, written to a log slot by slot in bounded memory.

Time is cut into slots of equal length; in each of them one fault begins after a quarter of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import celestcore as cc
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
from celestcore import quaternion, simulate
from celestcore.simulate import faults

RATE, WOBBLE, PERIOD = 0.0011, 0.1, 600.0
"""The body turns once an orbit [rad/s] and rolls to and fro [rad, s]."""
SIGMA_ARCSEC, ARW, RRW, GATE = 20.0, 1e-5, 1e-8, 0.9999
TILT = (0.9689124217106447, 0.0, 0.24740395925452294, 0.0)  # exp of half a radian about y
STEP = np.array([0.0, 2e-4, 0.0])
CAMERAS = ("star_1", "star_2")
LOG = f"""[log]
title = "Everything breaks once"
epoch = "2026-01-01T00:00:00"

[gyro]
arw = {ARW}
rrw = {RRW}

[star_1]
sigma_arcsec = {SIGMA_ARCSEC}

[star_2]
sigma_arcsec = {SIGMA_ARCSEC}
mounting = [{", ".join(str(v) for v in TILT)}]

[gate]
probability = {GATE}
"""
Change = Callable[[cc.SensorLog, float, float], cc.SensorLog]


@dataclass(frozen=True)
class Fault:
    """What is done from a slot's quarter on, for how long, and what a report should say of it.

    Attributes
    ----------
    name : str
    change : callable
        Takes the slot's log, begin and end.
    short, long : float
        How long it lasts [s], on a short flight and over a week.
    told : tuple of str
        Kinds of events of which the report must tell one; empty if no sensor shows the fault.
    sensor : str, optional
        Whose event.
    """

    name: str
    change: Change
    short: float
    long: float
    told: tuple[str, ...] = ()
    sensor: str | None = None
    shift: tuple[str, float] | None = None
    """A table whose clock runs ahead by so much [s] while the fault lasts, and then goes back."""


def _both(change: Callable[[cc.SensorLog, str], cc.SensorLog]) -> Change:
    """Do the same to both cameras."""

    def changed(log: cc.SensorLog, begin: float, end: float) -> cc.SensorLog:
        for name in CAMERAS:
            log = within(log, begin, end, lambda cut, name=name: change(cut, name))
        return log

    return changed


def within(
    log: cc.SensorLog, begin: float, end: float, change: Callable[[cc.SensorLog], cc.SensorLog]
) -> cc.SensorLog:
    """Change the stars of a part of a log only."""
    cut = {name: (log.stars[name].t >= begin) & (log.stars[name].t < end) for name in CAMERAS}
    inside = {n: (log.stars[n].t[cut[n]], log.stars[n].q[cut[n]]) for n in CAMERAS}
    made = change(cc.SensorLog(**inside))
    out: dict[str, Any] = {}
    for name in CAMERAS:
        q = np.array(log.stars[name].q)
        q[cut[name]] = made.stars[name].q
        out[name] = (log.stars[name].t, q)
    return cc.SensorLog(epoch=log.epoch, gyro=log.gyro, **out)


def _blind(log: cc.SensorLog, begin: float, end: float) -> cc.SensorLog:
    for name in CAMERAS:
        log = faults.dropout(log, name, begin, end)
    return log


def _crossed(log: cc.SensorLog, begin: float, end: float) -> cc.SensorLog:
    return within(log, begin, end, lambda cut: faults.swapped(cut, *CAMERAS))


REFUSED = ("refused", "restart")
FAULTS = [
    Fault("none", lambda log, *_: log, 0.0, 0.0),
    Fault("both cameras blinded", _blind, 60.0, 3600.0, ("silence",), "star_1"),
    Fault("gyro silent", lambda g, a, b: faults.dropout(g, "gyro", a, b), 20.0, 60.0, ("gap",)),
    Fault("gyro stuck", lambda g, a, b: faults.stuck(g, "gyro", a, b), 60.0, 600.0, REFUSED),
    Fault("gyro bias step, for good", lambda log, *_: log, 0.0, 0.0, REFUSED),
    Fault(
        "camera 1 turned by 0.05 rad",
        lambda g, a, b: faults.jump(g, "star_1", a, b, [0.0, 0.05, 0.0]),
        60.0,
        3600.0,
        ("refused",),
        "star_1",
    ),
    Fault(
        "camera 1 stuck",
        lambda g, a, b: faults.stuck(g, "star_1", a, b),
        60.0,
        3600.0,
        ("refused",),
        "star_1",
    ),
    Fault(
        "signs flipped, half of all fixes",
        _both(lambda cut, name: faults.sign_flips(cut, name, 0.5)),
        60.0,
        7200.0,
    ),
    Fault(
        "gyro clock 3 s ahead, and back",
        lambda log, *_: log,
        60.0,
        600.0,
        ("gap",),
        shift=("gyro", 3.0),
    ),
    Fault(
        "camera 2 clock 2 s ahead, and back",
        lambda log, *_: log,
        60.0,
        3600.0,
        ("refused",),
        "star_2",
        shift=("star_2", 2.0),
    ),
    Fault(
        "20 % outliers of 0.02 rad, both cameras",
        _both(lambda cut, name: faults.outliers(cut, name, 0.2, 0.02, seed=CAMERAS.index(name))),
        120.0,
        7200.0,
        ("scattered",),
        "star_1",
    ),
    Fault("gyro axis lost", lambda g, a, b: faults.lost_axis(g, a, b, 1), 60.0, 1800.0, REFUSED),
    Fault("cameras swapped", _crossed, 60.0, 600.0, REFUSED),
    Fault("nothing more", lambda log, *_: log, 0.0, 0.0),
]
AT_STEP = next(k for k, f in enumerate(FAULTS) if "bias step" in f.name)


@dataclass(frozen=True)
class Flight:
    """The faults on a time axis: slots of `slot` seconds."""

    slot: float
    week: bool

    @property
    def end(self) -> float:
        """Length [s]."""
        return self.slot * len(FAULTS)

    def begin_of(self, k: int) -> float:
        """When fault k begins [s]."""
        return self.slot * (k + 0.25)

    def end_of(self, k: int) -> float:
        """When fault k is over [s]."""
        return self.begin_of(k) + (FAULTS[k].long if self.week else FAULTS[k].short)

    def attitude(self, t: Any) -> Any:
        """Return the true attitude (n, 4)."""
        t = np.asarray(t)
        turn, roll = np.zeros((len(t), 3)), np.zeros((len(t), 3))
        turn[:, 1] = -RATE * t
        roll[:, 0] = WOBBLE * np.sin(2.0 * np.pi / PERIOD * t)
        return quaternion.multiply(quaternion.exp(turn), quaternion.exp(roll))

    def slots(self) -> Iterator[cc.SensorLog]:
        """Yield the log slot by slot, broken."""
        bias: Any = 0.0
        sigma = SIGMA_ARCSEC * cc.ARCSEC
        cameras = {
            "star_1": simulate.StarErrors(sigma, every=10),
            "star_2": simulate.StarErrors(sigma, every=10, mounting=TILT),
        }
        rows = round(self.slot * 10.0)
        for k, fault in enumerate(FAULTS):
            t = (k * rows + np.arange(rows + 1)) / 10.0  # the last one begins the next slot
            truth = simulate.attitude(t, self.attitude(t))
            spread = 1e-6 if k == 0 else 0.0
            gyro = simulate.GyroErrors(ARW, RRW, bias=bias, bias_sigma=spread)
            made = simulate.Scenario(truth, gyro, cameras).simulate(seed=7, trial=k)
            bias = made.bias[-1]
            log = _first(made.log, float(t[-1]))
            log = fault.change(log, self.begin_of(k), max(self.end_of(k), self.begin_of(k) + 1e-3))
            if k >= AT_STEP:
                log = faults.bias_step(log, self.begin_of(AT_STEP), 1e9, STEP)
            yield log

    def write(self, folder: Path) -> None:
        """Write the log: a folder of datasets, a file a slot."""
        for table in ("gyro", *CAMERAS):
            (folder / table).mkdir(parents=True)
        (folder / "log.toml").write_text(LOG, encoding="utf-8")
        for k, log in enumerate(self.slots()):
            columns = {"gyro": _flat(log.gyro.t, log.gyro.rate, ("wx", "wy", "wz"))}
            for name in CAMERAS:
                star = log.stars[name]
                columns[name] = _flat(star.t, star.q, ("qw", "qx", "qy", "qz"))
            if FAULTS[k].shift is not None:
                name, seconds = FAULTS[k].shift
                t = columns[name]["t"]
                ahead = (t >= self.begin_of(k)) & (t < self.end_of(k))
                columns[name]["t"] = np.where(ahead, t + seconds, t)  # goes back at the end
            for name, table in columns.items():
                pq.write_table(pa.table(table), folder / name / f"slot-{k:02d}.parquet")


def _first(log: cc.SensorLog, end: float) -> cc.SensorLog:
    """Return a log before a time."""
    stars = {n: (s.t[s.t < end], s.q[s.t < end]) for n, s in log.stars.items()}
    keep = log.gyro.t < end
    return cc.SensorLog(gyro=(log.gyro.t[keep], log.gyro.rate[keep]), **stars)


def _flat(t: Any, values: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {"t": t, **{name: np.ascontiguousarray(values[:, k]) for k, name in enumerate(names)}}


@dataclass
class Fared:
    """How a fault was borne.

    Attributes
    ----------
    bad : float
        How long the error was more than five sigma [s].
    back : float
        After its end, when that was so for the last time [s]; 0 if never after it.
    worst : float
        Largest error [arcsec].
    """

    bad: float = 0.0
    back: float = 0.0
    worst: float = 0.0


def fared(flight: Flight, out: Path, dt: float) -> list[Fared]:
    """Compare all rows with the truth, part by part; `dt` is the step of the rows."""
    found = [Fared() for _ in FAULTS]
    for path in sorted((out / "rows").glob("part-*.parquet")):
        rows = pq.read_table(path)
        t = rows["t"].to_numpy()
        q = np.stack([rows[c].to_numpy() for c in ("qw", "qx", "qy", "qz")], axis=1)
        error = quaternion.angle_between(q, flight.attitude(t))
        sigma = np.linalg.norm([rows[c].to_numpy() for c in ("s_ax", "s_ay", "s_az")], axis=0)
        assert np.isfinite(error).all()
        assert np.isfinite(sigma).all()
        slot = np.clip((t / flight.slot - 0.25).astype(int), 0, len(FAULTS) - 1)
        for k in np.unique(slot).tolist():
            mine, bad = slot == k, (slot == k) & (error > 5.0 * sigma)
            one = found[k]
            one.worst = max(one.worst, float(error[mine].max()) / cc.ARCSEC)
            one.bad += dt * int(bad.sum())
            if bad.any():
                one.back = max(one.back, float(t[bad].max()) - flight.end_of(k), 0.0)
    return found


def told_of(flight: Flight, k: int, events: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the event of a report that tells of fault k: of its kind, and nearest to its begin."""
    fault, begin = FAULTS[k], flight.begin_of(k)
    mine = [
        e
        for e in events
        if e["kind"] in fault.told and (fault.sensor is None or e["sensor"] in (fault.sensor, None))
    ]
    return min(mine, key=lambda e: abs(e["begin"] - begin), default=None)
