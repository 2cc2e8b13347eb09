"""What every test shares."""

import os
from pathlib import Path

import pytest

# Before anything compiles: kernels are kept from run to run, apart from the user's, by what they are made of.
os.environ.setdefault("NUMBA_CACHE_DIR", str(Path(__file__).parents[1] / ".kernel_cache"))


@pytest.fixture(autouse=True, scope="session")
def fields_are_cached_apart(tmp_path_factory):
    """Tests neither read nor fill the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDSIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
