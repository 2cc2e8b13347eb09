"""A Dask cluster's workers as a crew. Dask runs a chunk again whose worker died; that changes no answer."""

import contextlib
import logging
import threading
import time
import uuid
from typing import Any

from handsight.batch.run import DEATHS, Answers, Chunk, Died, Done, Events, Failed
from handsight.errors import HandsightError, MissingExtra

CONNECT_SECONDS = 5
ASK_SECONDS = 2
"""How often the scheduler is asked how many workers there are."""


class ClusterFailure(HandsightError):
    """A cluster that cannot be reached, or that cannot run handsight; the message starts with its address."""


def answer_on_worker(folder: str, lines: list[bytes]) -> Answers:
    """What runs on the cluster: `handsight.batch.worker.answer_lines`, with one thread for the kernels."""
    from handsight._kernels.threads import alone
    from handsight.batch.worker import answer_lines

    # Dask has a process or a thread for each core already.
    with alone():
        return answer_lines(folder, lines)


class Cluster:
    """A connection to a Dask scheduler; use it in `with`."""

    chunk_seconds = 0.5

    def __init__(self, address: str, folder: str, events: Events) -> None:
        """`folder`: where the workers find meshes, absolute. Raises ClusterFailure where nobody answers."""
        self._address, self._folder, self._events = address, folder, events
        self._client = _connected(address)
        self._job = uuid.uuid4().hex
        self._futures: dict[int, Any] = {}
        self._lock = threading.Lock()
        self._room, self._asked = 0, -float("inf")
        self._closing = False

    def __enter__(self) -> "Cluster":
        return self

    def __exit__(self, *_: object) -> None:
        """Drops what is not yet answered."""
        self._closing = True
        with contextlib.suppress(Exception):  # there may be nobody to tell
            self._client.cancel(list(self._futures.values()), force=True)
        with contextlib.suppress(Exception):
            self._client.close(timeout=CONNECT_SECONDS)

    def room(self) -> int:
        """Two chunks for each thread, so that none waits for us; workers may come and go."""
        now = time.monotonic()
        if now - self._asked > ASK_SECONDS:
            try:
                self._room = max(2, 2 * sum(self._client.nthreads().values()))
            except Exception as error:
                raise self._lost(error) from None
            self._asked = now
        return self._room

    def put(self, chunk: Chunk) -> None:
        """Sends the chunk to the cluster."""
        key = f"handsight-{self._job}-{chunk.first}-{chunk.deaths}"
        try:
            future = self._client.submit(answer_on_worker, self._folder, chunk.lines, key=key, pure=False)
        except Exception as error:
            raise self._lost(error) from None
        with self._lock:
            self._futures[chunk.first] = future
        future.add_done_callback(lambda done: self._finished(chunk, done))

    def _finished(self, chunk: Chunk, future: Any) -> None:
        """Runs in one of Dask's threads."""
        from distributed.scheduler import KilledWorker

        event: Done | Died | Failed
        try:
            event = Done(chunk, Answers(*future.result()))
        except KilledWorker:
            event = Died(chunk, workers=DEATHS)  # Dask has tried that often
        except BaseException as error:
            event = Failed(self._lost(error))
        with self._lock:
            self._futures.pop(chunk.first, None)
        if not self._closing:
            self._events.put(event)

    def _lost(self, error: BaseException) -> ClusterFailure:
        if isinstance(error, ModuleNotFoundError):
            return ClusterFailure(
                f"{self._address}: the workers have no module {error.name!r}; install handsight there"
            )
        return ClusterFailure(f"{self._address}: the cluster was lost ({type(error).__name__}: {error})")


def _connected(address: str) -> Any:
    try:
        from distributed import Client
        from distributed.comm.addressing import resolve_address
    except ImportError:
        raise MissingExtra("--cluster needs Dask: pip install 'handsight[cluster]'") from None
    _silence()
    try:
        # A client that was given nonsense hangs when it is disposed of.
        resolve_address(address)
        connect: Any = Client
        return connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        said = str(error).partition("\n")[0] or type(error).__name__
        raise ClusterFailure(f"{address}: expected a Dask scheduler there, got none ({said})") from None


def _silence() -> None:
    """Dask reports each lost connection with a traceback, by loggers of their own level; what matters is raised."""
    for name in ["distributed", *logging.root.manager.loggerDict]:
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
