"""Who is compared, one file each."""

import importlib
from collections.abc import Callable
from typing import Any

from benchmarks.workload import Peer


def _of(module: str, name: str, **options: object) -> Callable[[], Peer]:
    def make() -> Peer:
        return getattr(importlib.import_module(f"benchmarks.peers.{module}"), name)(**options)

    return make


MAKERS: dict[str, Callable[[], Peer]] = {
    "ours": _of("ours", "Ours"),
    "ours_kernel": _of("ours", "OursKernel"),
    "paper": _of("paper_numba", "PaperCompiled"),
    "open3d": _of("open3d_icp", "Open3DICP"),
    "small_gicp": _of("small_gicp", "SmallGICP"),
}
"""The peers that start from vision."""


FIRST_POSES: dict[str, Callable[[], Any]] = {
    "ours": _of("ours", "OursFirstPose"),
    "open3d_fpfh": _of("open3d_fpfh", "FpfhRansacIcp"),
    "opencv_ppf": _of("opencv_ppf", "PpfVotesIcp"),
}
"""The peers that find an object in a depth image."""


def made(
    names: list[str] | None = None, makers: dict[str, Callable[[], Any]] = MAKERS
) -> tuple[dict[str, Any], dict[str, str]]:
    """The peers of these names that can run here, and why the others cannot."""
    found: dict[str, Any] = {}
    missing: dict[str, str] = {}
    for name in names or makers:
        try:
            found[name] = makers[name]()
        except ImportError as error:
            missing[name] = f"not installed ({error}); pip install 'handsight[bench]'"
    return found, missing
