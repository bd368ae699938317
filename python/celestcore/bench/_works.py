"""All works, in the order of the table."""

from __future__ import annotations

from functools import lru_cache

from celestcore.bench import _attitude, _orbit, _resampling, _system
from celestcore.bench._work import Work
from celestcore.errors import InputError


@lru_cache(maxsize=1)
def all_works() -> tuple[Work, ...]:
    """Return all works."""
    parts = (_attitude, _orbit, _resampling, _system)
    return tuple(work for part in parts for work in part.works())


def chosen(names: str | None) -> tuple[Work, ...]:
    """Return the works of a comma-separated list of names, all without one.

    Raises
    ------
    InputError
        Names what is unknown.
    """
    if names is None:
        return all_works()
    wanted = [name.strip() for name in names.split(",") if name.strip()]
    known = {work.name: work for work in all_works()}
    for name in wanted:
        if name not in known:
            raise InputError(f"must be of {', '.join(known)}", field="--only", value=name)
    if not wanted:
        raise InputError("names no work", field="--only", value=names)
    return tuple(work for name, work in known.items() if name in wanted)
