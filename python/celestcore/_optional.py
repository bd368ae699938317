"""Import optional packages where they are used, with one clear sentence when they are missing."""

from __future__ import annotations

import importlib
from types import ModuleType

from celestcore.errors import MissingDependencyError


def require(module: str, *, extra: str, what: str) -> ModuleType:
    """Import an optional module.

    Parameters
    ----------
    module : str
        Its import name, for example ``"pyarrow.parquet"``.
    extra : str
        The extra of celestcore that installs it.
    what : str
        What it is needed for, for example ``"reading Parquet"``.

    Raises
    ------
    MissingDependencyError
        If it is not installed.

    Examples
    --------
    >>> require("math", extra="all", what="arithmetic").sqrt(4.0)
    2.0
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        package = module.partition(".")[0]
        raise MissingDependencyError(
            f"{what} needs {package}, which cannot be imported ({error}): "
            f"pip install 'celestcore[{extra}]'"
        ) from error
