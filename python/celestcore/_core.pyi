"""The compiled core. Arrays are C-contiguous float64; use the package's modules instead."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, final

import numpy as np
from numpy.typing import NDArray
from typing_extensions import Self, disjoint_base

__all__ = [
    "AttitudeStream",
    "GnssAttitude",
    "GnssOrbit",
    "OrbitStream",
    "RefractionTable",
    "Update",
    "__version__",
    "_bench_acceleration",
    "_bench_level",
    "_bench_propagate",
    "_bench_resample",
    "calibrate",
    "camera_isotropic",
    "camera_observe",
    "celestial_monte_carlo",
    "celestial_run",
    "celestial_simulate",
    "chi2_cdf",
    "chi2_quantile",
    "gnss_axis",
    "longest_step",
    "monte_carlo",
    "orbit_acceleration",
    "orbit_moments",
    "orbit_propagate",
    "quat_angle_between",
    "quat_conjugate",
    "quat_continuous",
    "quat_exp",
    "quat_from_matrix",
    "quat_log",
    "quat_multiply",
    "quat_propagate",
    "quat_right_jacobian",
    "quat_right_jacobian_inverse",
    "quat_rotate",
    "quat_shortest_rotation",
    "quat_slerp",
    "quat_to_matrix",
    "release_build",
    "replay",
    "replay_many",
    "simulate",
    "sky_visible",
    "wahba_solve",
]

_Array = NDArray[np.float64]
_Snapshot = tuple[
    float,
    Sequence[float],
    Sequence[float],
    _Array,
    tuple[float, Sequence[float]] | None,
    int,
    _Array,
    Sequence[float],
]

__version__: str
release_build: bool

def chi2_quantile(p: float, dof: float) -> float: ...
def chi2_cdf(x: float, dof: float) -> float: ...
def quat_exp(a: _Array) -> _Array: ...
def quat_log(a: _Array) -> _Array: ...
def quat_conjugate(a: _Array) -> _Array: ...
def quat_to_matrix(a: _Array) -> _Array: ...
def quat_from_matrix(a: _Array) -> _Array: ...
def quat_right_jacobian(a: _Array) -> _Array: ...
def quat_right_jacobian_inverse(a: _Array) -> _Array: ...
def quat_multiply(a: _Array, b: _Array) -> _Array: ...
def quat_rotate(a: _Array, b: _Array) -> _Array: ...
def quat_shortest_rotation(a: _Array, b: _Array) -> _Array: ...
def quat_angle_between(a: _Array, b: _Array) -> _Array: ...
def quat_slerp(a: _Array, b: _Array, s: _Array) -> _Array: ...
def quat_continuous(q: _Array, length: int) -> _Array: ...
def quat_propagate(q0: _Array, rates: _Array, dt: _Array, method: str) -> _Array: ...
def camera_isotropic(n: int, seed: int) -> _Array: ...
def camera_observe(
    q: _Array,
    directions: _Array,
    magnitudes: _Array,
    camera: tuple[float, float, float, int],
    shape: str,
    random: tuple[int, int],
    name: str,
) -> dict[str, Any]: ...
def wahba_solve(
    body: _Array,
    inertial: _Array,
    sigma: _Array | None,
    weights: _Array | None,
    frames: int,
    name: str,
) -> dict[str, Any]: ...
def orbit_propagate(
    forces: dict[str, Any],
    tables: dict[str, Any] | None,
    start: Sequence[float],
    t: _Array,
    method: str,
    rtol: float,
    step: float,
    stm: bool,
) -> tuple[_Array, _Array | None, int]: ...
def orbit_acceleration(
    forces: dict[str, Any], tables: dict[str, Any] | None, t: _Array, state: _Array
) -> tuple[_Array, _Array, _Array]: ...
def orbit_moments(tables: dict[str, Any], t: _Array) -> tuple[_Array, _Array, _Array]: ...
def replay(log: Mapping[str, Any], smoothed: bool) -> dict[str, Any]: ...
def replay_many(logs: Sequence[Mapping[str, Any]], threads: int) -> list[dict[str, Any] | str]: ...
def longest_step(t: _Array, medians: float) -> float: ...
def calibrate(
    log: Mapping[str, Any], aligned: int | None, prior: Sequence[float]
) -> dict[str, Any]: ...
def simulate(
    flight: Mapping[str, Any], seed: int, trial: int
) -> tuple[_Array, _Array, list[tuple[_Array, tuple[Any, _Array] | None]]]: ...
def monte_carlo(
    flight: Mapping[str, Any],
    estimators: Sequence[Mapping[str, Any]],
    seed: int,
    first: int,
    count: int,
    skip: float,
    threads: int,
    portable: bool,
    progress: Callable[[int, int], object] | None,
) -> list[dict[str, Any]]: ...
def celestial_run(
    setup: Mapping[str, Any],
    times: _Array,
    horizon: tuple[_Array, _Array, _Array] | None,
    refraction: tuple[_Array, _Array, _Array] | None,
    start: tuple[float, Sequence[float], _Array],
    every: int,
    covariance: bool,
    back: bool,
    portable: bool,
    progress: Callable[[int, int], object] | None,
) -> dict[str, Any]: ...
def sky_visible(
    field: Mapping[str, Any], stars: _Array, r: _Array, v: _Array
) -> tuple[Any, Any]: ...
def celestial_simulate(
    flight: Mapping[str, Any], seed: int, trial: int
) -> tuple[_Array, list[float]]: ...
def celestial_monte_carlo(
    flight: Mapping[str, Any],
    estimators: Sequence[Mapping[str, Any]],
    seed: int,
    first: int,
    count: int,
    skip: float,
    threads: int,
    portable: bool,
    progress: Callable[[int, int], object] | None,
) -> list[dict[str, Any]]: ...

@final
class RefractionTable:
    def __new__(cls, air: tuple[_Array, _Array] | None) -> Self: ...
    def density(self, height: _Array) -> _Array: ...
    def bending(self, height: _Array) -> _Array: ...
    def height(self, angle: _Array) -> _Array: ...
    def rays(
        self, r: _Array, star: _Array, pole: Sequence[float] | None, scale: float
    ) -> list[_Array]: ...
    def sights(
        self,
        states: _Array,
        stars: _Array,
        pole: Sequence[float] | None,
        band: Sequence[float],
        fields: Sequence[Sequence[float]],
    ) -> dict[str, Any]: ...
    def simulate(
        self,
        r: _Array,
        star: _Array,
        place: Sequence[Sequence[int]],
        pole: Sequence[float] | None,
        noise: Sequence[float],
        random: tuple[int, int],
    ) -> _Array: ...

@final
class Update:
    @property
    def accepted(self) -> bool: ...
    @property
    def nis(self) -> float: ...
    @property
    def dof(self) -> int: ...
    @property
    def innovation(self) -> _Array: ...
    @property
    def covariance(self) -> _Array: ...

@disjoint_base
class AttitudeStream:
    def __new__(
        cls,
        setup: Mapping[str, Any],
        to_body: Sequence[float] | None,
        t: float,
        q: Sequence[float],
        bias: Sequence[float],
        covariance: _Array,
        lag: float | None,
    ) -> Self: ...
    @property
    def t(self) -> float: ...
    @property
    def q(self) -> _Array: ...
    @property
    def bias(self) -> _Array: ...
    @property
    def covariance(self) -> _Array: ...
    def predict(self, t: float, rate: Any) -> None: ...
    def _process(
        self,
        rates: _Array,
        t: _Array | None,
        dt: _Array | None,
        step: float,
        every: int | None,
        covariance: bool,
    ) -> dict[str, Any] | None: ...
    def update_star(
        self, t: float, q: Sequence[float], noise: Sequence[float], sensor: int = 0
    ) -> Update: ...
    def update_vector(
        self,
        t: float,
        body: Sequence[float],
        inertial: Sequence[float],
        sigma: float,
        sensor: int = 0,
    ) -> Update: ...
    def _smoothed(self) -> tuple[_Array, _Array, _Array, _Array]: ...
    def _noise_scale(self) -> list[float]: ...
    def _snapshot(self) -> _Snapshot: ...
    def _restore(self, parts: Any) -> None: ...

# private: shortest of some runs [ns per item] and the result, for `celestcore bench`
def _bench_level() -> str: ...
def _bench_propagate(
    q0: Sequence[float], rates: _Array, dt: float, repeats: int
) -> tuple[float, _Array]: ...
def _bench_resample(
    way: str, weights: _Array, seed: int, repeats: int
) -> tuple[float, NDArray[np.uintp]]: ...
def _bench_acceleration(
    forces: Mapping[str, Any],
    tables: Mapping[str, Any] | None,
    t: _Array,
    state: _Array,
    repeats: int,
) -> tuple[float, _Array]: ...

@disjoint_base
class OrbitStream:
    def __new__(
        cls,
        setup: Mapping[str, Any],
        t: float,
        state: Sequence[float],
        covariance: _Array,
    ) -> Self: ...
    @property
    def t(self) -> float: ...
    @property
    def state(self) -> _Array: ...
    @property
    def covariance(self) -> _Array: ...
    def predict(self, t: float) -> None: ...
    def update_horizon(self, star: _Array, angle: _Array) -> Update: ...
    def update_refraction(self, star: _Array, angle: _Array) -> Update: ...

@final
class GnssOrbit:
    def __new__(
        cls,
        filter: str,  # noqa: A002 - the field's word
        weights: tuple[float, float, float | None],
        forces: Mapping[str, Any],
        tables: Mapping[str, Any] | None,
        accel_psd: float,
        max_step: float,
        bias: tuple[float, float] | None,
    ) -> Self: ...
    def run(
        self,
        stop: tuple[_Array, NDArray[np.bool_], _Array | None],
        fixes: tuple[_Array, NDArray[np.bool_], _Array, _Array],
        start: tuple[float, _Array, _Array],
        gate: float,
        back: bool,
        covariance: bool,
        portable: bool,
        progress: Callable[[int, int], object] | None,
    ) -> dict[str, Any]: ...

@final
class GnssAttitude:
    def __new__(
        cls,
        jerk_psd: float | None,
        gyro: tuple[float, float, bool] | None,
        tail: Sequence[tuple[float, float]],
    ) -> Self: ...
    def run(
        self,
        stop: tuple[_Array, NDArray[np.bool_], _Array | None],
        fixes: tuple[_Array, _Array, _Array, _Array],
        start: tuple[float, _Array, _Array],
        gate: float,
        back: bool,
        covariance: bool,
        portable: bool,
        progress: Callable[[int, int], object] | None,
    ) -> dict[str, Any]: ...

def gnss_axis(
    jerk_psd: float,
    stop: tuple[_Array, NDArray[np.bool_], _Array | None],
    fixes: tuple[_Array, NDArray[np.bool_], _Array, _Array],
    start: tuple[float, Sequence[float], Sequence[Sequence[float]]],
    wraps: bool,
    back: bool,
) -> dict[str, Any]: ...
