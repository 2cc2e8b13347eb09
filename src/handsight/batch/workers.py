"""Workers that answer chunks of lines: processes of this machine, or those of a Dask cluster."""

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
import warnings
from collections.abc import Callable
from concurrent.futures import CancelledError, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from multiprocessing.connection import Connection
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from handsight.errors import HandsightError, needing

if TYPE_CHECKING:
    from handsight.batch.problems import Reader

CONNECT_SECONDS = 5


class WorkerFailure(HandsightError):
    """Worker processes cannot work, or a cluster cannot be reached."""


class WorkerDied(Exception):
    """The worker of a chunk died, perhaps because of the chunk."""


class Answers(NamedTuple):
    """The answers to a chunk of lines."""

    texts: list[str]
    """A line of JSON for each line, without its newline."""
    warnings: list[str]


Work = Callable[[list[bytes]], Answers]


@functools.cache
def _reader(folder: str) -> "Reader":
    from handsight.batch.problems import Reader

    return Reader(Path(folder))


_one_at_a_time = threading.Lock()  # a reader's models must not be used by several threads of a Dask worker


def answer_lines(folder: str, lines: list[bytes]) -> Answers:
    """Returns the answers to lines, computed on one thread; relative paths of meshes start at `folder`."""
    from handsight._compiled.threads import alone
    from handsight.batch.problems import answer_text

    with _one_at_a_time, alone(), warnings.catch_warnings(record=True) as caught:
        texts = [answer_text(_reader(folder), line) for line in lines]
    return Answers(texts, [str(warning.message) for warning in caught])


def _to_file(work: Work, folder: str, lines: list[bytes]) -> str:
    """Returns the name of the file to which a worker has written its answers.

    A name goes through the executor's pipe at once. Of a long message, a worker that dies may send only a part, and the
    executor would wait for the rest forever.
    """
    with tempfile.NamedTemporaryFile("w", dir=folder, encoding="utf-8", delete=False) as file:
        json.dump(work(lines), file)
    return file.name


def _begin(lifeline: Connection) -> None:
    """Prepares a worker: it ignores Ctrl-C, prints on stderr, and ends when its parent closes the lifeline or ends."""

    def end_with_parent() -> None:
        with contextlib.suppress(EOFError, OSError):
            lifeline.recv_bytes()  # returns when the other end is closed, and only the parent has it
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.dup2(2, 1)  # a library's prints must not get between the answers
    threading.Thread(target=end_with_parent, daemon=True).start()


def _result(future: Any, died: type[Exception], who: str) -> Any:
    """Returns the result of a future; raises WorkerDied where that error says so, else WorkerFailure."""
    try:
        return future.result()
    except died:
        raise WorkerDied from None
    except (Exception, CancelledError, asyncio.CancelledError) as error:
        raise WorkerFailure(f"{who}: expected answers, got {type(error).__name__}: {error}") from None


class Processes(contextlib.AbstractContextManager["Processes"]):
    """Worker processes of this machine, to be used in `with`.

    When one dies, the chunks of all fail with WorkerDied, and the next chunk is submitted to new ones. They also end
    when they are left, whatever they compute, and when their parent ends.
    """

    def __init__(self, size: int, work: Work) -> None:
        """Raises WorkerFailure where no process can be started."""
        self.room = 4 * size
        self._size = size
        self._folder = tempfile.TemporaryDirectory(prefix="handsight-", ignore_cleanup_errors=True)
        self._work = work
        self._single: Processes | None = None
        # Chunks are submitted in the thread that reads, and the processes are ended in another.
        self._lock = threading.Lock()
        self._closed = False
        self._start()
        try:
            self._executor.submit(os.getpid).result()
        except (BrokenProcessPool, OSError) as error:
            self.__exit__()
            raise WorkerFailure(f"worker processes: cannot begin ({error}); --workers 1 needs none") from None

    def __exit__(self, *_: object) -> None:
        if self._single is not None:
            self._single.__exit__()
        with self._lock:
            self._closed = True
            self._end()
        self._folder.cleanup()

    def _start(self) -> None:
        context = multiprocessing.get_context("spawn")  # numba's threads do not survive a fork
        self._theirs, self._lifeline = context.Pipe(duplex=False)
        self._executor = ProcessPoolExecutor(self._size, context, _begin, (self._theirs,))

    def _end(self) -> None:
        self._lifeline.close()
        self._executor.shutdown(cancel_futures=True)
        self._theirs.close()

    def submit(self, lines: list[bytes]) -> "Future[str]":
        """Returns a future of the file with the answers to a chunk; raises WorkerFailure where no process can start."""
        work = functools.partial(_to_file, self._work, self._folder.name, lines)
        try:
            with self._lock:
                try:
                    return self._executor.submit(work)
                except (BrokenProcessPool, BrokenPipeError):  # a process has died since
                    if self._closed:
                        raise
                    self._end()
                    self._start()
                    return self._executor.submit(work)
        except (BrokenProcessPool, OSError) as error:
            raise WorkerFailure(f"worker processes: cannot begin ({error}); --workers 1 needs none") from None

    def answers(self, future: "Future[str]") -> Answers:
        """Returns the answers in the file that a future names; raises WorkerDied, WorkerFailure."""
        file = Path(_result(future, BrokenProcessPool, "worker"))
        found = Answers(*json.loads(file.read_bytes()))
        file.unlink()
        return found

    def alone(self, line: bytes) -> Answers:
        """Returns the answers to one line, by a process that has no other lines; raises as `answers`."""
        if self._single is None:
            self._single = Processes(1, self._work)
        return self._single.answers(self._single.submit([line]))


class Cluster(contextlib.AbstractContextManager["Cluster"]):
    """The workers of a Dask cluster, to be used in `with`; Dask itself repeats the chunk of a worker that dies."""

    room = 128

    def __init__(self, address: str, work: Work) -> None:
        """Raises WorkerFailure where no scheduler answers, MissingExtra without Dask."""
        with needing("--cluster needs Dask", "cluster"):
            from distributed import Client
            from distributed.comm.addressing import resolve_address
        # Dask logs a traceback for each lost connection, from loggers with their own levels; what matters is raised.
        for name in ["distributed", *logging.root.manager.loggerDict]:
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL + 1)
        self._address = address
        self._work = work
        try:
            # Checked first, as a client with a malformed address hangs on closing.
            resolve_address(address)
            connect: Any = Client  # without types
            self._client = connect(address, timeout=CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError, TypeError, RuntimeError) as error:
            message = str(error).partition("\n")[0] or type(error).__name__
            raise WorkerFailure(f"{address}: expected a Dask scheduler there, got none ({message})") from None

    def __exit__(self, *_: object) -> None:
        """Drops all chunks that are not answered yet."""
        with contextlib.suppress(Exception):  # the scheduler may be gone
            self._client.close(timeout=CONNECT_SECONDS)

    def submit(self, lines: list[bytes]) -> Any:
        """Returns Dask's future of the answers to a chunk."""
        return self._client.submit(self._work, lines, pure=False)

    def answers(self, future: Any) -> Answers:
        """Returns the result of a future; raises WorkerDied, and WorkerFailure where the cluster is lost."""
        from distributed.scheduler import KilledWorker

        return Answers(*_result(future, KilledWorker, self._address))

    def alone(self, line: bytes) -> Answers:
        """Returns the answers to one line, as a chunk of its own; raises as `answers`."""
        return self.answers(self.submit([line]))
