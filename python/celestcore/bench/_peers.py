"""The packages that do the same works, and which of them are here."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from typing import Any

from celestcore.bench._outcome import Outcome
from celestcore.bench._work import Entry
from celestcore.errors import InputError


@dataclass(frozen=True)
class Peer:
    """A package to compare with.

    Attributes
    ----------
    name : str
        Of the package, and of the option.
    module : str
        What is imported.
    how : str
        Arguments for pip that install it.
    """

    name: str
    module: str
    how: str

    def missing(self) -> str | None:
        """Return one line that says how to install it, or None if it is here."""
        try:
            importlib.import_module(self.module)
        except ImportError as error:
            return f"{self.name} is left out ({error}): pip install {self.how}"
        return None

    @property
    def version(self) -> str:
        """Its version."""
        try:
            return version(self.name)
        except PackageNotFoundError:
            return "unknown"


EXTRA = "'celestcore[bench]'"
PEERS = {
    peer.name: peer
    for peer in (
        Peer("numpy", "numpy", "numpy"),
        Peer("scipy", "scipy", "'celestcore[scipy]'"),
        Peer("numba", "numba", EXTRA),
        Peer("numpy-quaternion", "quaternion", EXTRA),
        Peer("filterpy", "filterpy.kalman", EXTRA),
        Peer("jax", "jax", "jax"),
        # asks for an older numpy than works, see docs/benchmarks.md
        Peer("particles", "particles", "--no-deps particles joblib scikit-learn"),
        Peer("satkit", "satkit", "satkit satkit-data"),
        Peer("brahe", "brahe", "brahe"),
    )
}


def named(names: Iterable[str]) -> list[Peer]:
    """Return peers by name; ``all`` stands for every one.

    Raises
    ------
    InputError
        Names what is unknown.
    """
    wanted: dict[str, Peer] = {}
    for name in names:
        if name == "all":
            wanted |= PEERS
        elif name in PEERS:
            wanted[name] = PEERS[name]
        else:
            known = ", ".join(PEERS)
            raise InputError(
                f"must be of {known}, 'all', or a program to run", field="--against", value=name
            )
    return list(wanted.values())


def loaded(entry: Entry) -> Callable[[Any], Callable[[], Outcome]]:
    """Import what a peer does."""
    module, _, function = entry.where.partition(":")
    found: Callable[[Any], Callable[[], Outcome]] = getattr(
        importlib.import_module(module), function
    )
    return found
