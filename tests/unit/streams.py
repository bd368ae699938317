"""What a filter that is fed sample by sample carries, for tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from celestcore.navigator import StarGyroState


def everything(state: StarGyroState) -> tuple[Any, ...]:
    """All that a state carries, comparable with ==."""
    t, q, bias, matrix, last, steps, past, scale = state._snapshot()
    latest = None if last is None else (last[0], tuple(last[1]))
    columns = np.asarray(matrix).tobytes(), past.tobytes()
    return t, tuple(q), tuple(bias), *columns, latest, steps, *scale
