"""Lines answered by many workers: read as they come, answered in order, never all in memory."""

import codecs
import contextlib
import functools
import io
import json
import os
import threading
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from handsight.batch.workers import DEATHS, Answers, Cluster, Processes, WorkerDied, answer_lines
from handsight.errors import InvalidFile
from handsight.files import stream_name

LONGEST = 32_000_000
"""Largest size of a line [bytes]; decoded, it takes up to thirty times as much memory."""
BLOCK_BYTES = 256_000
Source = io.BufferedIOBase


class BatchLimits(NamedTuple):
    """`BatchLimits` bound how much of a batch is in memory at the same time."""

    chunk_lines: int = 256  # largest number of lines in a worker's chunk
    max_pending_bytes: int = 64_000_000
    """No line is submitted while lines without a returned answer take more."""
    line_overhead: int = 3000  # memory of a line besides its characters: its answer, Python's objects [bytes]


BATCH = BatchLimits()
Answered = tuple[list[bytes], Answers]
"""Consecutive lines with their answers."""
Event = list[bytes] | BaseException | None | Future[Answers]
"""Lines that were read; or the end of the input, as None or an error; or the future of a chunk that is done."""


@contextlib.contextmanager
def answering(
    source: Source,
    folder: Path,
    *,
    single: bool = False,
    workers: int = 1,
    cluster: str | None = None,
    first: Callable[[], object] = os.getpid,
) -> Iterator[Iterator[Answered]]:
    """Yields an iterator over the lines with their answers, in order.

    They are answered by this process (`workers` 1), by that many worker processes (0: one for each core), or by the
    Dask cluster at an address. `source` is closed at its end. `single`: the entire source is one line. `folder`:
    absolute; relative paths of meshes start here. `first` is called in the first worker process before it answers
    anything. Raises WorkerFailure, InvalidFile.
    """
    if workers == 1 and cluster is None:
        from handsight.batch.problems import Reader, answer_text

        reader = Reader(folder)
        yield (
            ([line], Answers([answer_text(reader, line)], 0.0, []))
            for lines in blocks(source, single=single)
            for line in lines
        )
        return
    available = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    work = functools.partial(answer_lines, str(folder))
    with Cluster(cluster, work) if cluster else Processes(workers or available, work, first) as those:
        yield iter(Batch(source, those, single=single))


class Batch:
    """A `Batch` sends lines to workers; iterating over it, once, gives the lines with their answers in order.

    One thread reads the lines. Everything else happens in the thread that iterates, driven by a queue of events.
    """

    def __init__(self, source: Source, workers: Processes | Cluster, *, single: bool = False) -> None:
        """`source` is closed at its end. `single`: the entire source is one line."""
        self._blocks, self._workers = blocks(source, single=single), workers
        self._events: SimpleQueue[Event] = SimpleQueue()
        self._wanted: SimpleQueue[bool] = SimpleQueue()
        """Whether to read on: True is put when all lines that were read have been submitted, False at the end."""
        self._reading = True
        self._failure: BaseException | None = None
        self._lines: list[bytes] = []
        self._submitted: deque[tuple[list[bytes], Future[Answers]]] = deque()
        self._running = self._pending_bytes = 0
        # Number of lines in the next chunk; 1 at first, so that a few slow lines are spread over all workers.
        self._size = 1

    def __iter__(self) -> Iterator[Answered]:
        # A daemon thread, never joined, as nothing can interrupt it while it waits for input.
        threading.Thread(target=self._read, name="handsight-reader", daemon=True).start()
        try:
            while self._reading or self._submitted:
                self._submit()
                if not self._submitted or not self._submitted[0][1].done():
                    self._take(self._events.get())
                    continue
                lines, future = self._submitted.popleft()
                try:
                    answers = future.result()
                except WorkerDied:
                    yield from self._one_by_one(lines)
                else:
                    yield lines, answers
                self._pending_bytes -= _bytes(lines)
        finally:
            self._wanted.put(False)
        if self._failure is not None:
            raise self._failure

    def _read(self) -> None:
        """Puts lines into the queue of events; it runs in the reading thread."""
        end = None
        try:
            for lines in self._blocks:
                self._events.put(lines)
                if not self._wanted.get():
                    return
        except BaseException as error:  # of any kind: the thread that waits for the answers must get it
            end = error
        self._events.put(end)

    def _submit(self) -> None:
        """Submits chunks of the lines that were read, while there is room."""
        most = BATCH.max_pending_bytes
        while self._lines and self._running < self._workers.room and self._pending_bytes < most:
            chunk = self._lines[: self._size]
            future = self._workers.submit(chunk)
            del self._lines[: self._size]
            self._submitted.append((chunk, future))
            self._pending_bytes += _bytes(chunk)
            self._running += 1
            future.add_done_callback(self._events.put)
            if not self._lines:
                self._wanted.put(True)

    def _take(self, event: Event) -> None:
        """Updates the state by an event, and adapts the size of chunks to the duration of the last one."""
        if isinstance(event, list):
            self._lines = event
        elif not isinstance(event, Future):
            self._reading, self._failure = False, event
        else:
            self._running -= 1
            if event.exception() is None:
                # At most doubled or halved in one step, as a chunk may be unlike the others.
                answers = event.result()
                aim = len(answers.texts) * self._workers.chunk_seconds / max(answers.seconds, 1e-9)
                self._size = int(min(max(aim, self._size / 2, 1), 2 * self._size, BATCH.chunk_lines))

    def _one_by_one(self, lines: list[bytes]) -> Iterator[Answered]:
        """Yields the answers to lines whose worker died, submitted one by one to find the line that kills workers."""
        while self._running:
            self._take(self._events.get())
        message = f"line: expected a problem that a worker survives, got {DEATHS} that died (out of memory?)"
        for line in lines:
            answers = Answers([json.dumps({"error": message})], 0.0, [])
            for _ in range(DEATHS):
                with contextlib.suppress(WorkerDied):
                    answers = self._workers.submit([line]).result()
                    break
            yield [line], answers


def _bytes(lines: list[bytes]) -> int:
    return sum(len(line) + BATCH.line_overhead for line in lines)


def blocks(source: Source, *, single: bool = False) -> Iterator[list[bytes]]:
    """Yields lists of the lines that are available, without blank ones and line ends; closes the source.

    A byte order mark at the beginning is dropped. A line longer than `LONGEST` is cut to `LONGEST` + 1 bytes, so that
    a reader can refuse it. `single`: the entire source is one line. Raises InvalidFile.
    """
    marks = codecs.BOM_UTF8
    with source:
        try:
            if single:
                yield [source.read(LONGEST + 1 + len(marks)).removeprefix(marks)]
                return
            for lines in _split(source):
                lines[0], marks = lines[0].removeprefix(marks), b""
                if come := [line for line in lines if line.strip() or len(line) > LONGEST]:
                    yield come
        except OSError as error:
            raise InvalidFile(f"{stream_name(source)}: {error.strerror or error}") from None


def _split(source: Source) -> Iterator[list[bytes]]:
    """Yields lists of the complete lines that are available, at least one in each; lines too long are cut."""
    partial = bytearray()
    while block := source.read1(BLOCK_BYTES):
        *lines, rest = block.split(b"\n")
        if lines:
            lines[0] = bytes(partial + lines[0])[: LONGEST + 1]
            partial.clear()
            yield lines
        partial += rest[: LONGEST + 1 - len(partial)]
    yield [bytes(partial)]
