"""Who answers chunks of lines: processes of this machine, or the workers of a Dask cluster."""

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
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, NamedTuple

from handsight.errors import HandsightError, MissingExtra

if TYPE_CHECKING:
    from handsight.batch.problems import Reader

DEATHS = 3
"""Workers that may die on the same lines before the lines are to blame."""
CONNECT_SECONDS = 5
THREADS = ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
ENVIRONMENT = {**dict.fromkeys(THREADS, "1"), "PYTHONSAFEPATH": "1"}
"""A worker for each core leaves none over for threads; and a module of the current folder is none of ours."""


class WorkerFailure(HandsightError):
    """Processes that cannot work, or a cluster that cannot be reached."""


class Answers(NamedTuple):
    """An `Answers` is what a worker made of a chunk of lines."""

    texts: list[str]
    """One line of JSON for each line, without its end."""
    seconds: float
    warnings: list[str]


Work = Callable[[list[bytes]], Answers]


@functools.cache
def _reader(folder: str) -> "Reader":
    from handsight.batch.problems import Reader

    return Reader(Path(folder))


_one_at_a_time = threading.Lock()  # the models kept are not made to be shared by a Dask worker's threads


def answer_lines(folder: str, lines: list[bytes]) -> Answers:
    """Returns the answers to lines whose meshes are in `folder`, on one thread; models are built once in a process."""
    from handsight._kernels.runtime.threads import alone
    from handsight.batch.problems import answer_text

    with _one_at_a_time, alone(), warnings.catch_warnings(record=True) as caught:
        began = time.perf_counter()
        texts = [answer_text(_reader(folder), line) for line in lines]
        seconds = time.perf_counter() - began
    return Answers(texts, seconds, [str(warning.message) for warning in caught])


def _to_file(work: Work, folder: str, lines: list[bytes]) -> str:
    """Returns the file that a worker's answers are in.

    Its name goes through the pool's pipe whole or not at all. Of a longer message a worker that dies may leave a part,
    and the pool would wait for the rest forever.
    """
    with tempfile.NamedTemporaryFile("w", dir=folder, encoding="utf-8", delete=False) as file:
        json.dump(work(lines), file)
    return file.name


def _from_file(named: Future[str], answers: Future[Answers]) -> None:
    """Hands on what a worker answered, or that it did not."""
    try:
        path = Path(named.result())
        answers.set_result(Answers(*json.loads(path.read_bytes())))
        path.unlink()
    except BaseException as error:  # whoever waits must hear of it
        answers.set_exception(error)


class Processes(contextlib.AbstractContextManager["Processes"]):
    """`Processes` are worker processes of this machine; use it in `with`. When one dies all are replaced, and their
    chunks fail."""

    chunk_seconds = 0.1
    """How long one of them should be busy with a chunk."""

    def __init__(self, size: int, work: Work, first: Callable[[], object] = os.getpid) -> None:
        """`first` is called in the first worker before it works."""
        self.room = size
        """How many chunks they take at the same time: one each."""
        self._work, self._first = work, first
        self._folder = tempfile.TemporaryDirectory(prefix="handsight-", ignore_cleanup_errors=True)
        # New programs, not forks: a thread pool does not survive a fork.
        self._context = multiprocessing.get_context("spawn")
        self._pool: ProcessPoolExecutor | None = None

    def __exit__(self, *_: object) -> None:
        self._end()
        self._folder.cleanup()

    def _end(self) -> None:
        """Ends all workers, whatever they are doing."""
        if self._pool is not None:
            self._lifeline.close()
            self._pool.shutdown(cancel_futures=True)
            self._theirs.close()
            self._pool = None

    def submit(self, lines: list[bytes]) -> Future[Answers]:
        """Returns the answers to come; starts a worker where none is idle. Raises WorkerFailure where none can be
        had."""
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

    def answers(self, future: Future[Answers]) -> Answers | None:
        """Returns the answers once they are there, None where a worker died; raises WorkerFailure for what else went
        wrong."""
        try:
            return future.result()
        except BrokenProcessPool:
            return None
        except Exception as error:
            raise WorkerFailure(f"worker: {type(error).__name__}: {error}") from None

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
            except (BrokenProcessPool, OSError) as error:  # it may die before it has read what to do
                _check_broken(error)
                self._end()
        message = ", ".join(str(child.exitcode) for child in children)
        raise WorkerFailure(
            f"worker processes end as they start (exit code {message}); --workers 1 needs none"
        )


def _check_broken(error: BrokenProcessPool | OSError) -> None:
    """Raises WorkerFailure where this is not of a pool with a dead worker, which may close its pipes before it says
    that it is broken."""
    if not isinstance(error, BrokenProcessPool | BrokenPipeError) and str(error) != "handle is closed":
        raise WorkerFailure(f"worker processes cannot begin ({error}); --workers 1 needs none") from None


@contextlib.contextmanager
def _spawning() -> Iterator[None]:
    """Processes that begin within have the workers' environment, and never hear of Ctrl-C."""
    before = {name: os.environ[name] for name in ENVIRONMENT if name in os.environ}
    masks = hasattr(signal, "pthread_sigmask")  # a mask is inherited, and nothing is lost meanwhile
    mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT}) if masks else set()
    os.environ.update(ENVIRONMENT)
    try:
        yield
    finally:
        for name in ENVIRONMENT:
            del os.environ[name]
        os.environ.update(before)
        if masks:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)


def _begin(lifeline: Connection) -> None:
    """Does what a worker does first."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Whatever a library prints must not come between the answers.
    os.dup2(2, 1)
    threading.Thread(target=_end_with, args=(lifeline,), daemon=True).start()


def _end_with(lifeline: Connection) -> None:
    """Ends this process as soon as the other end, which only its parent has, is closed."""
    with contextlib.suppress(EOFError, OSError):
        lifeline.recv_bytes()
    os._exit(1)


class Cluster(contextlib.AbstractContextManager["Cluster"]):
    """A `Cluster` is a Dask cluster's workers; use it in `with`. Dask runs a chunk again whose worker died; that
    changes no answer."""

    chunk_seconds = 0.5
    room = 128
    """Dask spreads the chunks over its workers, which may come and go."""

    def __init__(self, address: str, work: Work) -> None:
        """Raises WorkerFailure where no scheduler answers, MissingExtra without Dask."""
        self._address, self._work = address, work
        self._client = _connected(address)
        self._ended: SimpleQueue[tuple[Any, Future[Answers]]] = SimpleQueue()
        # A daemon of our own: whoever fetches from a cluster that is lost may wait forever.
        threading.Thread(target=self._fetch, name="handsight-fetcher", daemon=True).start()

    def __exit__(self, *_: object) -> None:
        """Drops what is not yet answered."""
        with contextlib.suppress(Exception):  # there may be nobody to tell
            self._client.close(timeout=CONNECT_SECONDS)

    def submit(self, lines: list[bytes]) -> Future[Answers]:
        """Returns the answers to come; raises WorkerFailure where the cluster was lost."""
        # Not by Client.get_executor(), whose futures never end where the scheduler is lost.
        try:
            there = self._client.submit(self._work, lines, pure=False)
        except Exception as error:
            raise self._lost(error) from None
        answers: Future[Answers] = Future()
        there.add_done_callback(lambda there: self._ended.put((there, answers)))
        return answers

    def answers(self, future: Future[Answers]) -> Answers | None:
        """Returns the answers once they are there, None where workers died; raises WorkerFailure where the cluster
        was lost."""
        from distributed.scheduler import KilledWorker

        try:
            return future.result()
        except KilledWorker:
            return None
        except Exception as error:
            raise self._lost(error) from None

    def _fetch(self) -> None:
        while True:
            there, answers = self._ended.get()
            try:
                answers.set_result(Answers(*there.result()))
            except BaseException as error:
                answers.set_exception(error)

    def _lost(self, error: Exception) -> WorkerFailure:
        message = f"the cluster was lost ({type(error).__name__}: {error})"
        if isinstance(error, ModuleNotFoundError):
            message = f"the workers have no module {error.name!r}; install handsight there"
        return WorkerFailure(f"{self._address}: {message}")


def _connected(address: str) -> Any:
    try:
        from distributed import Client
        from distributed.comm.addressing import resolve_address
    except ImportError:
        raise MissingExtra("--cluster needs Dask: pip install 'handsight[cluster]'") from None
    # Dask reports each lost connection with a traceback, by loggers of their own level; what matters is raised.
    for name in ["distributed", *logging.root.manager.loggerDict]:
        if name.partition(".")[0] == "distributed":
            logging.getLogger(name).setLevel(logging.CRITICAL + 1)
    try:
        # A client that was given nonsense hangs when it is disposed of.
        resolve_address(address)
        connect: Any = Client
        return connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        message = str(error).partition("\n")[0] or type(error).__name__
        raise WorkerFailure(f"{address}: expected a Dask scheduler there, got none ({message})") from None
