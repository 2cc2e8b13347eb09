"""Worker processes on this machine. One that dies is replaced, and whoever waits for its answers is told."""

import contextlib
import os
import pickle
import subprocess
import sys
import threading
from queue import SimpleQueue
from typing import Any

from handsight.batch.run import DEATHS, Answers, Chunk, Died, Done, Events, Failed
from handsight.errors import HandsightError

ONE_THREAD = dict.fromkeys(
    ("NUMBA_NUM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1"
)
"""A worker for each core leaves none over for threads."""
PROGRAM = "handsight.batch.worker"


class CrewFailure(HandsightError):
    """Workers that cannot work."""


class _Lost(Exception):
    """The process ended."""


class _Worker:
    """A process that answers chunks; new programs, not forks: a thread pool does not survive a fork."""

    def __init__(self, folder: str) -> None:
        # The parent's path, and nothing of the current folder. A session of its own keeps Ctrl-C from it.
        environment = {**os.environ, **ONE_THREAD, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", PROGRAM],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            env=environment,
            start_new_session=True,
        )
        self._folder = folder

    def begin(self) -> None:
        """Waits until it is ready; raises _Lost."""
        self._send(self._folder)
        self._receive()

    def answer(self, chunk: Chunk) -> Answers:
        """The answers; raises _Lost."""
        self._send(chunk.lines)
        answers: Answers = self._receive()
        return answers

    def _send(self, value: Any) -> None:
        try:
            pickle.dump(value, self.process.stdin)  # type: ignore[arg-type]
            self.process.stdin.flush()  # type: ignore[union-attr]
        except (OSError, ValueError):
            raise _Lost from None

    def _receive(self) -> Any:
        try:
            return pickle.load(self.process.stdout)  # type: ignore[arg-type]
        except (EOFError, OSError, ValueError, pickle.UnpicklingError):
            raise _Lost from None

    def end(self) -> None:
        """Ends the process; whatever it was doing is lost."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            with contextlib.suppress(OSError):
                pipe.close()  # type: ignore[union-attr]


class Processes:
    """A number of worker processes, each with a thread here that talks to it; use it in `with`."""

    chunk_seconds = 0.1

    def __init__(self, size: int, folder: str, events: Events) -> None:
        """`folder`: what mesh paths are relative to."""
        self._size, self._folder, self._events = size, folder, events
        self._chunks: SimpleQueue[Chunk | None] = SimpleQueue()
        self._workers: set[_Worker] = set()
        self._threads: list[threading.Thread] = []
        self._closing = False
        self._lock = threading.Lock()

    def __enter__(self) -> "Processes":
        return self

    def __exit__(self, *reason: object) -> None:
        """Ends all workers, whatever they are doing."""
        with self._lock:
            self._closing = True
            for worker in self._workers:
                worker.process.kill()
        for _ in self._threads:
            self._chunks.put(None)
        for thread in self._threads:
            thread.join()

    def room(self) -> int:
        """One chunk each."""
        return self._size

    def put(self, chunk: Chunk) -> None:
        """Gives the chunk to the next worker that is free; the first chunks start a worker each."""
        self._chunks.put(chunk)
        if len(self._threads) < self._size:
            thread = threading.Thread(target=self._serve, name="handsight-worker", daemon=True)
            self._threads.append(thread)
            thread.start()

    def _serve(self) -> None:
        try:
            while (worker := self._start()) is not None:
                try:
                    self._employ(worker)
                finally:
                    self._dismiss(worker)
        except HandsightError as error:
            self._events.put(Failed(error))
        except Exception as error:  # who waits for this thread's answers must hear of it, whatever it is
            self._events.put(Failed(CrewFailure(f"worker: {type(error).__name__}: {error}")))

    def _employ(self, worker: _Worker) -> None:
        """Has chunks answered until the worker dies or there are no more."""
        while (chunk := self._chunks.get()) is not None:
            if worker.process.poll() is not None:  # died idle: no fault of this chunk
                self._chunks.put(chunk)
                return
            try:
                answers = worker.answer(chunk)
            except _Lost:
                self._events.put(Died(chunk))
                return
            self._events.put(Done(chunk, answers))

    def _start(self) -> _Worker | None:
        """A worker that is ready; None when closing; raises CrewFailure where none can be had."""
        for _ in range(DEATHS):
            with self._lock:
                if self._closing:
                    return None
                worker = _Worker(self._folder)
                self._workers.add(worker)
            try:
                worker.begin()
            except _Lost:
                self._dismiss(worker)
            else:
                return worker
        if self._closing:
            return None
        code = worker.process.returncode
        raise CrewFailure(f"worker processes end as they start (exit code {code}); --workers 1 needs none")

    def _dismiss(self, worker: _Worker) -> None:
        with self._lock:
            self._workers.discard(worker)
        worker.end()
