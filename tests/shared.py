"""What one worker of a run makes and the others read."""

import contextlib
import hashlib
import os
import pickle
from pathlib import Path

with contextlib.suppress(ImportError):  # not on Windows: there workers may do the same work twice
    import fcntl

FOLDER = "HANDSIGHT_TESTS_SHARED"
"""The variable that names the folder of this run."""


@contextlib.contextmanager
def locked(path):
    """Inside, no other worker is; a worker that is killed leaves nothing locked."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("a") as file:
        if "fcntl" in globals():
            fcntl.flock(file, fcntl.LOCK_EX)
        yield


def made_once(key, make):
    """What `make()` answers, made by one worker and read (pickled) by the others.

    The key says all that the answer depends on, as text.
    """
    path = Path(os.environ[FOLDER]) / f"{hashlib.sha256(key.encode()).hexdigest()[:16]}.pickle"
    with locked(path.with_suffix(".lock")):
        if not path.exists():
            path.write_bytes(pickle.dumps(make()))
    return pickle.loads(path.read_bytes())


def simulated(scenario):
    """All samples of a scenario, simulated once in a run."""
    from handsight.simulation import simulate

    return made_once(repr(scenario), lambda: list(simulate(scenario)))
