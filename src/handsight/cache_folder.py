"""Where handsight keeps what it can compute again: distance fields, compiled kernels."""

import os
from pathlib import Path


def cache_folder() -> Path:
    """`$HANDSIGHT_CACHE`, else `$XDG_CACHE_HOME/handsight`, else `~/.cache/handsight`; it may not exist yet."""
    if named := os.environ.get("HANDSIGHT_CACHE"):
        return Path(named)
    if base := os.environ.get("XDG_CACHE_HOME"):
        return Path(base) / "handsight"
    return Path(os.path.expanduser("~")) / ".cache" / "handsight"
