"""What the command line says and returns after Ctrl-C, where something is kept."""

from __future__ import annotations

from celestcore.errors import CelestcoreError


class Interrupted(CelestcoreError):  # noqa: N818  (a user sees its message only)
    """Ctrl-C: what was finished is kept."""

    exit_code = 130
