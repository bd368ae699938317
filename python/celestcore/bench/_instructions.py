"""Instruction counts of kernels, as ``make instructions`` writes them."""

from __future__ import annotations

import json
import math
from pathlib import Path

from celestcore.errors import InputError

FIELD = "--instructions"


def read(path: Path) -> dict[str, float]:
    """Return the instructions for each item of every kernel in a file.

    Raises
    ------
    InputError
        The file cannot be read, or is not of that kind.
    """
    try:
        told = json.loads(path.read_text(encoding="utf-8"))
        kernels = told["kernels"]
        counts = {str(name): float(one["instructions"]) for name, one in kernels.items()}
    except OSError as error:
        raise InputError(
            f"cannot be read: {error.strerror or error}", field=FIELD, value=str(path)
        ) from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise InputError(
            "is not what `make instructions` writes", field=FIELD, value=str(path)
        ) from None
    if not all(math.isfinite(count) and count > 0.0 for count in counts.values()):
        raise InputError("has counts that are not positive", field=FIELD, value=str(path))
    return counts
