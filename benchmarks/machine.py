"""On what the figures were measured; nothing that would tell whose machine it is."""

from __future__ import annotations

import os
import platform
import re
from datetime import UTC, datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("wheelsight", "numpy", "numba", "scipy", "opencv-python-headless", "open3d")


def description() -> dict[str, str]:
    """Date, processor, cores, load, system and versions, in words."""
    return {
        "Date": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "Processor": f"{_processor()}, {os.cpu_count()} cores",
        "Load": f"{os.getloadavg()[0]:.2f} processes running on average in the minute before the start",
        "System": f"{platform.system()} {platform.machine()}, {platform.python_implementation()} "
        f"{platform.python_version()}",
        "Versions": ", ".join(f"{name} {_version(name)}" for name in _PACKAGES),
    }


def is_busy() -> bool:
    """Whether other work on this machine would show in the times."""
    return os.getloadavg()[0] > 0.5


def _processor() -> str:
    cpuinfo = Path("/proc/cpuinfo")
    found = re.search(r"^model name\s*:\s*(.+)$", cpuinfo.read_text(), re.MULTILINE) if cpuinfo.exists() else None
    return found[1].strip() if found else platform.processor() or "unknown"


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"
