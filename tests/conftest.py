"""What all tests share: the `long` and `bench` marks, and which celestcore is under test."""

from __future__ import annotations

import signal
from pathlib import Path

import celestcore
import pytest
from celestcore import _core

ROOT = Path(__file__).resolve().parent.parent
MARKS = {
    "long": "takes minutes; run by `make long` or `pytest -m long`",
    "bench": "measures speed; run by `make bench` or `pytest -m bench`",
}


def pytest_configure(config: pytest.Config) -> None:
    # in the background of a shell Ctrl-C is ignored, by what is started here too: tests that send
    # it would wait for ever
    signal.signal(signal.SIGINT, signal.default_int_handler)
    for name, meaning in MARKS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")


def pytest_report_header() -> str:
    build = "release" if _core.release_build else "debug"
    place = Path(celestcore.__file__).parent
    return f"celestcore {celestcore.__version__}, {build} build, from {place}"


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Leave `long` and `bench` tests out unless ``-m`` names their mark."""
    chosen = config.getoption("markexpr") or ""
    if "bench" in chosen and not _core.release_build:
        raise pytest.UsageError(
            "a debug build says nothing of speed: `make bench` builds the wheel"
        )
    left_out = [name for name in MARKS if name not in chosen]
    kept: list[pytest.Item] = []
    dropped: list[pytest.Item] = []
    for item in items:
        out = any(item.get_closest_marker(name) for name in left_out)
        (dropped if out else kept).append(item)
    if dropped:
        config.hook.pytest_deselected(items=dropped)
        items[:] = kept


@pytest.fixture
def root() -> Path:
    """Return the top folder of the repository."""
    return ROOT
