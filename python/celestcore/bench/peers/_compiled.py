"""numba's `njit` where it is installed; without it functions stay as they are."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

F = TypeVar("F", bound=Callable[..., Any])

try:
    from numba import njit
except ImportError:
    njit = None


def compiled(function: F) -> F:
    """Compile a function at its first call, sums reordered and fused as LLVM likes."""
    if njit is None:
        return function
    made: F = njit(fastmath={"contract", "reassoc", "nsz", "arcp"})(function)
    return made
