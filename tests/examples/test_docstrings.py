"""Everything public says what it is, what its arguments are, and shows an example that runs.

The examples themselves run as doctests of the installed package (`make test-python`); only those
of `celestcore.reproduce`, which take seconds, are skipped there and run from the guide instead.
"""

from __future__ import annotations

import importlib
import inspect
import pkgutil
import re
import warnings
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType
from typing import Any

import celestcore
import pytest


def modules() -> Iterator[ModuleType]:
    """Yield the package and its modules without a leading underscore.

    Modules inside a subpackage are how it is made: what is public there, it exports itself.
    """
    yield celestcore
    for found in pkgutil.iter_modules(celestcore.__path__):
        if not found.name.startswith("_"):
            module = importlib.import_module(f"celestcore.{found.name}")
            exported = [getattr(module, name) for name in getattr(module, "__all__", ())]
            yield from (module, *(m for m in exported if inspect.ismodule(m)))


def public() -> dict[str, Any]:
    """Return what is public, by the shortest name that leads to it, each thing once."""
    found: dict[str, Any] = {}
    seen: set[int] = set()
    for module in modules():
        found[module.__name__] = module
        for name in getattr(module, "__all__", ()):
            item = getattr(module, name)
            own = getattr(item, "__module__", "").startswith("celestcore")
            if id(item) in seen or not own or not (inspect.isclass(item) or callable(item)):
                continue
            if not (inspect.isclass(item) or inspect.isfunction(item)):
                continue  # an alias of types
            seen.add(id(item))
            where = f"{module.__name__}.{name}"
            found[where] = item
            found.update(members(where, item) if inspect.isclass(item) else {})
    return found


def members(where: str, cls: type) -> dict[str, Any]:
    """Return the public methods and properties that a class defines itself."""
    own = {n: m for n, m in vars(cls).items() if not n.startswith("_")}
    plain = {
        n: m.__func__ if isinstance(m, (classmethod, staticmethod)) else m for n, m in own.items()
    }
    return {
        f"{where}.{n}": m
        for n, m in plain.items()
        if inspect.isfunction(m) or isinstance(m, property)
    }


with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    PUBLIC = public()
CALLABLE = {n: o for n, o in PUBLIC.items() if inspect.isfunction(o)}
SHOWN = {n: o for n, o in PUBLIC.items() if inspect.isfunction(o) or inspect.isclass(o)}


def text(item: Any) -> str:
    """Return a docstring of its own: one that is not inherited, nor made up by dataclass."""
    doc = inspect.cleandoc(item.__doc__ or "")
    made_up = inspect.isclass(item) and doc.startswith(f"{item.__name__}(")
    return "" if made_up else doc


def section(doc: str, title: str) -> str:
    """Return the body of a section of a numpy docstring, empty if there is none."""
    head = rf"(?:^|\n){title}\n-{{{len(title)}}}\n"
    found = re.search(rf"{head}(.*?)(?=\n\n?[A-Z][a-z]+(?: [A-Z][a-z]+)?\n-{{4,}}\n|\Z)", doc, re.S)
    return found.group(1) if found else ""


def arguments(function: Any) -> list[str]:
    names = list(inspect.signature(function).parameters)
    return [n for n in names if n not in ("self", "cls")]


def test_the_walk_finds_the_package() -> None:
    assert {"celestcore.StarGyroNavigator.run", "celestcore.wahba.solve"} <= set(CALLABLE)
    assert "celestcore.StarGyroState.sigma" in PUBLIC
    assert len(SHOWN) > 80


@pytest.mark.parametrize("name", PUBLIC)
def test_has_a_summary(name: str) -> None:
    summary = text(PUBLIC[name]).partition("\n\n")[0]
    assert summary.endswith((".", ":")), f"{name} needs a docstring that begins with a sentence"


@pytest.mark.parametrize("name", SHOWN)
def test_shows_an_example_that_runs(name: str) -> None:
    example = section(text(SHOWN[name]), "Examples")
    assert ">>> " in example, f"{name} needs an Examples section"
    assert "+SKIP" not in example or name.startswith("celestcore.reproduce."), f"{name} skips"


@pytest.mark.parametrize("name", CALLABLE)
def test_documents_every_argument(name: str) -> None:
    names = arguments(CALLABLE[name])
    heads = re.findall(r"^(\*{0,2}\w+(?:, \*{0,2}\w+)*)(?: : .*)?$", described(name), re.M)
    documented = [n.strip("* ") for head in heads for n in head.split(",")]
    assert sorted(documented) == sorted(names), (
        f"{name}: the Parameters section does not list its arguments"
    )


def described(name: str) -> str:
    return section(text(CALLABLE[name]), "Parameters")


@pytest.mark.parametrize("name", [n for n in CALLABLE if "Raises" in text(CALLABLE[n])])
def test_raises_what_exists(name: str) -> None:
    body = section(text(CALLABLE[name]), "Raises")
    heads = re.findall(r"^(\w+(?:, \w+)*)$", body, re.M)
    assert heads, f"{name}: the Raises section names no exception"
    for head in ",".join(heads).replace(" ", "").split(","):
        assert hasattr(celestcore, head) or hasattr(__import__("builtins"), head), head


REFERENCE = (Path(__file__).resolve().parents[2] / "docs" / "reference.md").read_text()
LISTED = set(re.findall(r"^::: (celestcore\S*)$", REFERENCE, re.M))


@pytest.mark.parametrize("name", SHOWN)
def test_stands_in_the_reference(name: str) -> None:
    """The reference lists it, or its class or module."""
    item = SHOWN[name]
    own = item.__qualname__.partition(".")[0]
    assert item.__module__ in LISTED or any(way.endswith(f".{own}") for way in LISTED), name
