"""Workers that answer chunks of lines: processes of this machine, or a Dask cluster."""

import asyncio
import contextlib
import functools
import json
import logging
import multiprocessing
import os
import signal
import tempfile
import threading
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from handsight.errors import HandsightError, needing

if TYPE_CHECKING:
    from handsight.batch.problems import Reader

DEATHS = 3
"""If so many workers die on the same line, the line is to blame."""
CONNECT_SECONDS = 5
RETURN_SECONDS = 60
"""How long a scheduler that was lost is waited for."""


class WorkerFailure(HandsightError):
    """Worker processes cannot work, or a cluster cannot be reached."""


class WorkerDied(Exception):
    """The worker of a chunk died, perhaps because of the chunk."""


class Answers(NamedTuple):
    """An `Answers` has a worker's answers to a chunk of lines."""

    texts: list[str]
    """A line of JSON for each line, without its newline."""
    seconds: float
    warnings: list[str]


Work = Callable[[list[bytes]], Answers]


@functools.cache
def _reader(folder: str) -> "Reader":
    from handsight.batch.problems import Reader

    return Reader(Path(folder))


_one_at_a_time = threading.Lock()  # a reader's models must not be used by several threads of a Dask worker


def answer_lines(folder: str, lines: list[bytes]) -> Answers:
    """Returns the answers to lines, computed on one thread; relative paths of meshes start at `folder`."""
    from handsight._kernels.runtime.threads import alone
    from handsight.batch.problems import answer_text

    with _one_at_a_time, alone(), warnings.catch_warnings(record=True) as caught:
        began = time.perf_counter()
        texts = [answer_text(_reader(folder), line) for line in lines]
        seconds = time.perf_counter() - began
    return Answers(texts, seconds, [str(warning.message) for warning in caught])


def _to_file(work: Work, folder: str, lines: list[bytes]) -> str:
    """Returns the name of the file to which a worker has written its answers.

    A name is sent through the pool's pipe completely or not at all. Of a long message, a dying worker may send only a
    part, and the pool would wait for the rest forever.
    """
    with tempfile.NamedTemporaryFile("w", dir=folder, encoding="utf-8", delete=False) as file:
        json.dump(work(lines), file)
    return file.name


def _from_file(named: Future[str], answers: Future[Answers]) -> None:
    """Sets the result of `answers` to those in the named file, or its exception to WorkerDied or WorkerFailure."""
    try:
        path = Path(named.result())
        found = Answers(*json.loads(path.read_bytes()))
        path.unlink()
        answers.set_result(found)
    except (BrokenProcessPool, CancelledError):
        answers.set_exception(WorkerDied())
    except BaseException as error:  # of any kind: the thread that waits for the answers must get it
        answers.set_exception(WorkerFailure(f"worker: {type(error).__name__}: {error}"))


class Processes(contextlib.AbstractContextManager["Processes"]):
    """`Processes` are worker processes of this machine, to be used in `with`.

    When one dies, all are replaced, and all their chunks fail with WorkerDied.
    """

    chunk_seconds = 0.1
    """How long a chunk should keep a worker busy."""

    def __init__(self, size: int, work: Work, first: Callable[[], object] = os.getpid) -> None:
        """`first` is called in the first worker before it answers anything."""
        self.room = size
        """Number of chunks that can be submitted at the same time: one for each process."""
        self._work, self._first = work, first
        self._folder = tempfile.TemporaryDirectory(prefix="handsight-", ignore_cleanup_errors=True)
        # "spawn", as numba's thread pool does not survive a fork.
        self._context = multiprocessing.get_context("spawn")
        self._pool: ProcessPoolExecutor | None = None

    def __exit__(self, *_: object) -> None:
        self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        """Ends all workers at once."""
        if self._pool is not None:
            self._lifeline.close()
            self._pool.shutdown(cancel_futures=True)
            self._theirs.close()
            self._pool = None

    def submit(self, lines: list[bytes]) -> Future[Answers]:
        """Returns a future of the answers to a chunk, which may end with WorkerDied or WorkerFailure.

        Raises WorkerFailure where no worker can be started.
        """
        while True:
            pool = self._pool or self._started()
            try:
                with _spawning():
                    named = pool.submit(_to_file, self._work, self._folder.name, lines)
            except (BrokenProcessPool, OSError) as error:
                _check_broken(error)
                self._end()
            else:
                answers: Future[Answers] = Future()
                named.add_done_callback(functools.partial(_from_file, answers=answers))
                return answers

    def _started(self) -> ProcessPoolExecutor:
        """Returns a pool whose first worker is ready."""
        for _ in range(DEATHS):
            self._theirs, self._lifeline = self._context.Pipe(duplex=False)
            self._pool = ProcessPoolExecutor(self.room, self._context, _begin, (self._theirs,))
            children = []
            try:
                with _spawning():
                    ready = self._pool.submit(self._first)
                children = multiprocessing.active_children()
                ready.result()
                return self._pool
            except (BrokenProcessPool, OSError) as error:  # the worker may have died before it read its work
                _check_broken(error)
                self._end()
        codes = ", ".join(str(child.exitcode) for child in children)
        raise WorkerFailure(f"worker processes end as they start (exit code {codes}); --workers 1 needs none")


def _check_broken(error: BrokenProcessPool | OSError) -> None:
    """Raises WorkerFailure unless the error means that a worker died.

    Then the pool's pipes may be closed before the pool itself notices.
    """
    if not isinstance(error, BrokenProcessPool | BrokenPipeError) and str(error) != "handle is closed":
        raise WorkerFailure(f"worker processes cannot begin ({error}); --workers 1 needs none") from None


@contextlib.contextmanager
def _spawning() -> Iterator[None]:
    """Processes started inside have one thread each, no modules of the current folder, and Ctrl-C blocked."""
    names = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    environment = {**dict.fromkeys(names, "1"), "PYTHONSAFEPATH": "1"}
    before = {name: os.environ[name] for name in environment if name in os.environ}
    masks = hasattr(signal, "pthread_sigmask")  # processes inherit the mask, and a blocked signal is not lost
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    os.environ.update(environment)
    try:
        yield
    finally:
        for name in environment:
            del os.environ[name]
        os.environ.update(before)
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _begin(lifeline: Connection) -> None:
    """Prepares a worker: it ignores Ctrl-C, prints on stderr, and ends when its parent ends."""

    def end_with_parent() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv_bytes()  # returns when the other end is closed, and only the parent has it
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # a library's prints must not get between the answers
    threading.Thread(target=end_with_parent, daemon=True).start()


class Cluster(contextlib.AbstractContextManager["Cluster"]):
    """A `Cluster` has the workers of a Dask cluster, to be used in `with`.

    If a worker dies, Dask repeats its chunk, which gives the same answers. If the scheduler dies, what it has lost is
    submitted again as soon as one answers at its address.
    """

    chunk_seconds = 0.5
    room = 128
    """Number of chunks that can be submitted at the same time; Dask spreads them over its workers."""

    def __init__(self, address: str, work: Work) -> None:
        """Raises WorkerFailure where no scheduler answers, MissingExtra without Dask."""
        with needing("--cluster needs Dask", "cluster"):
            from distributed import Client
            from distributed.comm.addressing import resolve_address
        # Dask logs a traceback for each lost connection, from loggers with their own levels; what matters is raised.
        for name in ["distributed", *logging.root.manager.loggerDict]:
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self._address, self._work = address, work
        self._client_type: Any = Client
        try:
            # Checked first, as a client with a malformed address hangs on closing.
            resolve_address(address)
            self._client = self._connected()
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            message = str(error).partition("\n")[0] or type(error).__name__
            raise WorkerFailure(f"{address}: expected a Dask scheduler there, got none ({message})") from None
        self._ended: SimpleQueue[tuple[Any, Any, list[bytes], Future[Answers]]] = SimpleQueue()
        # In a daemon thread, as fetching results from a lost cluster may never end.
        threading.Thread(target=self._fetch, name="handsight-fetcher", daemon=True).start()

    def __exit__(self, *_: object) -> None:
        """Drops all chunks that are not answered yet."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self._client.close(timeout=CONNECT_SECONDS)

    def submit(self, lines: list[bytes]) -> Future[Answers]:
        """Returns a future of a chunk's answers, which may end with WorkerFailure, or WorkerDied of several workers."""
        answers: Future[Answers] = Future()
        self._send(lines, answers)
        return answers

    def _connected(self) -> Any:
        """Returns a new client; raises OSError where no scheduler answers."""
        return self._client_type(self._address, timeout=CONNECT_SECONDS, set_as_default=False)

    def _send(self, lines: list[bytes], answers: Future[Answers]) -> None:
        """Submits a chunk; `_fetch` gets it when it is done or lost."""
        client, failed = self._client, Future[Answers]()
        # Not Client.get_executor(), whose futures never end if the scheduler is lost.
        try:
            submitted = client.submit(self._work, lines, pure=False)
        except Exception as error:
            failed.set_exception(error)
            submitted = failed
        submitted.add_done_callback(lambda done: self._ended.put((client, done, lines, answers)))

    def _fetch(self) -> None:
        """Sets the results of the futures, and submits again what a scheduler has lost; it runs in its own thread."""
        from distributed.comm.core import CommClosedError
        from distributed.scheduler import KilledWorker

        while True:
            client, done, lines, answers = self._ended.get()
            try:
                answers.set_result(Answers(*done.result()))
            except KilledWorker:
                answers.set_exception(WorkerDied())
            except BaseException as error:
                gone = isinstance(error, CancelledError | asyncio.CancelledError | CommClosedError)
                if (gone or getattr(client, "status", "") != "running") and self._returned(client):
                    self._send(lines, answers)
                else:
                    message = f"the cluster was lost ({type(error).__name__}: {error})"
                    if isinstance(error, ModuleNotFoundError):
                        message = f"the workers have no module {error.name!r}; install handsight there"
                    answers.set_exception(WorkerFailure(f"{self._address}: {message}"))

    def _returned(self, lost: Any) -> bool:
        """Returns whether a scheduler answers again at the address, after `RETURN_SECONDS` at most, and replaces the
        client that has lost it; once no scheduler has returned, the answer is no."""
        until = time.monotonic() + RETURN_SECONDS
        while self._client is lost is not None:
            with contextlib.suppress(OSError, ValueError, TypeError, RuntimeError):
                self._client = self._connected()
            if self._client is lost and time.monotonic() > until:
                self._client = None
        with contextlib.suppress(Exception):
            lost.close(timeout=CONNECT_SECONDS)
        return self._client is not None
