"""What a measurement was made on."""

from __future__ import annotations

import os
import platform
from datetime import date
from pathlib import Path
from typing import Any

import numpy as np

from celestcore import _core

CPU_INFO = Path("/proc/cpuinfo")


def cpu_model() -> str:
    """Return the processor's name."""
    if CPU_INFO.is_file():
        for line in CPU_INFO.read_text(encoding="utf-8", errors="replace").splitlines():
            name, _, value = line.partition(":")
            if name.strip() == "model name":
                return value.strip()
    return platform.processor() or platform.machine()


def machine() -> dict[str, Any]:
    """Return processor, instruction set, system and versions."""
    return {
        "date": date.today().isoformat(),
        "cpu": cpu_model(),
        "processors": os.cpu_count(),
        "level": _core._bench_level(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": platform.python_version(),
        "numpy": np.__version__,
        "celestcore": _core.__version__,
    }
