"""numpy-quaternion: the turns of all steps at once, then their product one by one."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celestcore.bench._inputs import AttitudeInput
from celestcore.bench._outcome import Outcome


def propagation(given: AttitudeInput) -> Callable[[], Outcome]:
    """Return a call that propagates the readings."""
    import quaternion

    def call() -> Outcome:
        turns = quaternion.from_rotation_vector(given.dt * given.gyro[:-1])
        q = quaternion.quaternion(1.0, 0.0, 0.0, 0.0)
        history = np.empty(len(given.gyro), dtype=quaternion.quaternion)
        history[0] = q
        for k, turn in enumerate(turns, 1):
            q = q * turn
            history[k] = q
        return {"q": quaternion.as_float_array(history)[-1]}

    return call
