"""What every test shares, and what the workers of a run share: compiled kernels, distance fields, simulations."""

import contextlib
import hashlib
import os
import pickle
import warnings
from pathlib import Path

import hypothesis
import pytest

from handsight import cache_folder

with contextlib.suppress(ImportError):  # not on Windows: there workers may do the same work twice
    import fcntl

# Before anything compiles: kernels are kept from run to run, apart from the user's, by what they are made of; not in a
# checkout that others can write to.
with warnings.catch_warnings(action="ignore", category=cache_folder.CacheWarning):
    os.environ.setdefault(
        "NUMBA_CACHE_DIR", str(cache_folder.private_folder(Path(__file__).parents[1] / ".kernel_cache"))
    )
cache_folder._warn_once.cache_clear()


# The same examples every time, however busy the machine; other ones with --hypothesis-profile=explore.
hypothesis.settings.register_profile(
    "handsight",
    derandomize=True,
    deadline=None,
    suppress_health_check=[hypothesis.HealthCheck.too_slow],
)
hypothesis.settings.register_profile("explore", deadline=None)
hypothesis.settings.load_profile("handsight")


@contextlib.contextmanager
def locked(path):
    """Inside, no other worker is; a worker that is killed leaves nothing locked."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        if "fcntl" in globals():
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def pytest_sessionstart(session):
    """Workers compile different kernels at the same time, each of them once, and wait for each other's."""
    worker = getattr(session.config, "workerinput", None)
    if worker is None:
        return  # a few tests need few kernels, and compile those
    from handsight._kernels.runtime import kernel_cache
    from handsight.tracking import warm

    count, k = int(worker["workercount"]), int(worker["workerid"].removeprefix("gw"))
    names = list(warm.GROUPS)
    for name in sorted(names, key=lambda name: (names.index(name) % count != k, names.index(name))):
        done = kernel_cache.folder() / f"{name}.done"
        with locked(done.with_suffix(".lock")):
            if not done.exists():
                warm.GROUPS[name]()
                done.touch()


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory):
    """A folder of this run that all its workers have."""
    mine = tmp_path_factory.getbasetemp()
    folder = (mine.parent if "PYTEST_XDIST_WORKER" in os.environ else mine) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(autouse=True, scope="session")
def fields_are_cached_apart(shared_folder):
    """Tests neither read nor fill the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("HANDSIGHT_CACHE", str(shared_folder / "cache"))
        yield


@pytest.fixture(scope="session")
def made_once(shared_folder):
    """`made_once(key, make)`: what `make()` answers, made by one worker and read (pickled) by the others.

    The key says all that the answer depends on, as text.
    """

    def made(key, make):
        name = hashlib.sha256(key.encode()).hexdigest()[:16]
        path = shared_folder / f"{name}.pickle"
        with locked(path.with_suffix(".lock")):
            if not path.exists():
                path.write_bytes(pickle.dumps(make()))
        return pickle.loads(path.read_bytes())

    return made


@pytest.fixture(scope="session")
def simulated(made_once):
    """`simulated(scenario)`: all its samples, simulated once in a run."""
    from handsight.simulation import simulate

    return lambda scenario: made_once(repr(scenario), lambda: list(simulate(scenario)))
