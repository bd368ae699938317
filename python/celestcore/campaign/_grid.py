"""The grid: lists over dotted settings, and the cells that they make."""

from __future__ import annotations

import copy
import json
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import product
from math import prod
from typing import Any

from celestcore.campaign._schema import Tables, plain, table
from celestcore.errors import InputError

MOST = 10**6
"""Cells beyond which a grid is taken for a mistake."""
OF_CAMPAIGN = ("skip_s", "smooth", "start")
"""Keys of ``[campaign]`` that may differ from cell to cell."""
NOISE = ("sigma", "covariance")


@dataclass(frozen=True)
class Grid:
    """Settings by their dotted names, each with its values.

    >>> grid = Grid.read({"filter.kind": ["ekf", "ukf"], "star": {"sigma_arcsec": [2, 5]}})
    >>> len(grid), next(grid.cells())
    (4, {'filter.kind': 'ekf', 'star.sigma_arcsec': 2})
    """

    lists: Mapping[str, list[Any]]

    def __len__(self) -> int:
        return prod(len(values) for values in self.lists.values())

    @classmethod
    def read(cls, values: Any) -> Grid:
        """Check the table ``[grid]``.

        Raises
        ------
        InputError
            If it is empty, a list is, or a value stands there twice.
        """
        lists = _flat("", table("grid", values))
        if not lists:
            raise InputError(
                'is empty: give lists, such as "filter.kind" = ["ekf", "ukf"], or leave it out',
                field="grid",
            )
        for name, found in lists.items():
            _check(name, found)
        grid = cls(lists)
        if len(grid) > MOST:
            raise InputError(f"makes {len(grid):,} cells; {MOST:,} are possible", field="grid")
        return grid

    def cells(self) -> Any:
        """Run over the combinations, the last setting changing fastest."""
        for values in product(*self.lists.values()):
            yield dict(zip(self.lists, values, strict=True))


def _flat(before: str, values: Mapping[str, Any]) -> dict[str, list[Any]]:
    """Return lists by dotted names: quoted in the file, or as tables within tables."""
    out: dict[str, list[Any]] = {}
    for key, value in values.items():
        name = f"{before}{key}"
        found = _flat(f"{name}.", value) if isinstance(value, Mapping) else {name: value}
        for one in found:
            if one in out:
                raise InputError("is given twice", field=f"grid.{one}")
        out |= found
    return out


def _check(name: str, values: Any) -> None:
    where = f"grid.{name}"
    first, _, key = name.partition(".")
    if not key or first in ("grid", "logs"):
        raise InputError("is no setting; write for example star.sigma_arcsec", field=where)
    if first == "campaign" and key not in OF_CAMPAIGN:
        known = ", ".join(f"campaign.{k}" for k in OF_CAMPAIGN)
        raise InputError(f"cannot differ from cell to cell; {known} can", field=where)
    if not isinstance(values, list | tuple):
        raise InputError("must be a list of values", field=where, value=values)
    if not values:
        raise InputError("is empty: give one value at least", field=where)
    seen: set[str] = set()
    for value in values:
        text = canonical(value)
        if text in seen:
            raise InputError("stands there twice", field=where, value=value)
        seen.add(text)


def overlaid(document: Mapping[str, Any], cell: Mapping[str, Any]) -> dict[str, Any]:
    """Return a document with a cell's values put on top, whatever unit stood there before.

    Another kind of filter replaces the options of the one that stood there.
    """
    out = copy.deepcopy(dict(document))
    for name, value in cell.items():
        *path, key = name.split(".")
        place: Any = out
        for k, part in enumerate(path):
            place = place.setdefault(part, {})
            if not isinstance(place, dict):
                field = ".".join(path[: k + 1])
                raise InputError(f"is no table, but the grid sets {name}", field=field)
        if name == "filter.kind" and place.get(key, value) != value:
            place.clear()
        same = NOISE if plain(key) in NOISE else (plain(key),)
        for other in [k for k in place if plain(k) in same and f"{'.'.join(path)}.{k}" not in cell]:
            del place[other]
        place[key] = value
    return out


def canonical(value: Any) -> str:
    """Return one text for equal settings: 5 and 5.0 are the same, the order of keys is none."""
    return json.dumps(_floats(value), sort_keys=True, separators=(",", ":"))


def _floats(value: Any) -> Any:
    if isinstance(value, bool) or value is None or isinstance(value, str):
        return value
    if isinstance(value, int):
        return float(value) if abs(value) <= 2**53 else str(value)
    if isinstance(value, float):
        return value
    if isinstance(value, Mapping):
        return {str(key): _floats(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_floats(item) for item in value]
    raise InputError("must be a number, a text, true or false, or a list of these", value=value)


def label(cell: Mapping[str, Any]) -> str:
    """Return a cell in words.

    >>> label({"filter.kind": "ekf", "star.sigma_arcsec": 2})
    'filter.kind = ekf, star.sigma_arcsec = 2'
    """
    return ", ".join(f"{name} = {value}" for name, value in cell.items())


__all__ = ["Grid", "Tables", "canonical", "label", "overlaid"]
