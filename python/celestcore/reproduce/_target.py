"""What was asked of an experiment, and what came out."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Target:
    """One line: `met` is None where there are too few runs to tell, or it was not run."""

    block: str
    asked: str
    found: str
    met: bool | None

    def to_dict(self) -> dict[str, Any]:
        """Return it ready for JSON."""
        return asdict(self)
