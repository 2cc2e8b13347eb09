"""What every test shares."""

import pytest


@pytest.fixture(autouse=True, scope="session")
def fields_are_cached_apart(tmp_path_factory):
    """Tests neither read nor fill the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDSIGHT_CACHE", str(tmp_path_factory.mktemp("cache")))
        yield
