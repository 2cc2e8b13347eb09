"""Where and with what a run was made."""

import importlib.metadata
import os
import platform
from datetime import UTC, datetime
from typing import Any

from testbed import report

PACKAGES = ("handsight", "numpy", "scipy", "numba", "trimesh", "open3d", "small_gicp")


def description() -> dict[str, Any]:
    """Returns processor, cores, load before the run, and versions."""
    return {
        "description": report.machine(),
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": [round(x, 2) for x in os.getloadavg()] if hasattr(os, "getloadavg") else None,
        "system": platform.platform(terse=True),
        "versions": {name: _version(name) for name in PACKAGES},
        "when": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _version(name: str) -> str | None:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return None
