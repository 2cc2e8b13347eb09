"""Kernels of the tests' own, kept on disk from run to run and from worker to worker as the package's are."""

import hashlib
import inspect
from pathlib import Path

from handsight._kernels.runtime.compilation import entry


def kept(function):
    """As `entry`; compiled again when its file has changed, of which numba sees the function's byte code alone."""
    kernel = entry(function)
    source = hashlib.sha256(Path(inspect.getfile(function)).read_bytes()).hexdigest()[:8]
    kernel._cache._cache_file._kernel += f".{source}"
    return kernel
