"""Which navigators can be replayed in parts, and what goes over a log for each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from celestcore._arguments import checked
from celestcore.celestial import CelestialNavigator
from celestcore.gnss import GnssStarNavigator
from celestcore.navigator import StarGyroNavigator
from celestcore.replay._filter import StarGyroForward
from celestcore.replay._forward import Forward, Source, refused
from celestcore.replay._gnss import GnssForward

Maker = Callable[[Any, Mapping[str, Any], Source], Forward]
KINDS: dict[type, Maker] = {
    StarGyroNavigator: StarGyroForward,
    GnssStarNavigator: GnssForward,
    CelestialNavigator: refused,
}


def forward_of(navigator: Any, options: Mapping[str, Any], source: Source) -> Forward:
    """Return what goes over a log with this navigator.

    Raises
    ------
    InputError
        If it cannot be split, or an option does not go with it.
    """
    checked(navigator, "navigator", *KINDS)
    make = next(make for kind, make in KINDS.items() if isinstance(navigator, kind))
    return make(navigator, options, source)
