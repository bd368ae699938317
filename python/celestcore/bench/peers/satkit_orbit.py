"""satkit: its spherical harmonics, called for each position."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from celestcore.bench._orbit import DEGREE, GravityInput
from celestcore.bench._outcome import Outcome


def gravity(given: GravityInput) -> Callable[[], Outcome]:
    """Return a call of `satkit.gravity`; the turns to the Earth and back are given."""
    import satkit

    turn, r = given.to_earth, given.state[:, :3]

    def call() -> Outcome:
        at = np.einsum("nij,nj->ni", turn, r)
        model = satkit.gravmodel.jgm3
        a = [satkit.gravity(x, model=model, degree=DEGREE, order=DEGREE) for x in at]
        return {"a": np.einsum("nji,nj->ni", turn, np.array(a))}

    return call
