"""Kernels of the tests' own, kept on disk from run to run and from worker to worker as the package's are."""

import hashlib
import inspect
from pathlib import Path

from handsight._kernels.runtime.compilation import entry


def kept(function):
    """As `entry`; compiled again when its file has changed, which the stamp of the package's kernels does not cover."""
    kernel = entry(function)
    source = hashlib.sha256(Path(inspect.getfile(function)).read_bytes()).hexdigest()[:8]
    kernel._cache.name += f".{source}"
    return kernel
