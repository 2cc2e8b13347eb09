"""Many lines answered by many workers: read as they come, answered anywhere, handed on in order, never all in memory.

A thread reads lines and submits them in chunks; the caller's thread hands on the answers, and tries lines again whose
worker died.
"""

import contextlib
import functools
import io
import json
import os
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Future
from pathlib import Path
from queue import SimpleQueue
from typing import NamedTuple

from handsight.batch.workers import DEATHS, Answers, Cluster, Processes, answer_lines
from handsight.errors import InvalidFile

CHUNK_LINES = 256
BLOCK_BYTES = 256_000
HELD_BYTES = 64_000_000
"""Lines that wait for their answer or for an earlier line's; above it nothing more is begun."""
LINE_BYTES = 3000
"""What a line takes besides its characters: its answer and Python's own."""
Source = io.BufferedIOBase


class Answered(NamedTuple):
    """Consecutive lines with their answers."""

    lines: list[bytes]
    texts: list[str]
    """One line of JSON for each line, without its end."""
    warnings: list[str]
    """What workers warned of meanwhile."""


@contextlib.contextmanager
def answering(
    source: Source,
    folder: Path,
    *,
    whole: bool = False,
    workers: int = 1,
    cluster: str | None = None,
    first: Callable[[], object] = os.getpid,
) -> Iterator[Iterator[Answered]]:
    """The lines with their answers, in order: from this process (1 worker), from `workers` others (0: one for each
    core), or from the Dask cluster at an address.

    `source` is closed at its end; `whole`: all of it is one line. `folder`: what mesh paths are relative to, absolute.
    `first` is called in the first worker process before it works. Raises WorkerFailure, InvalidFile.
    """
    if workers == 1 and cluster is None:
        yield _here(source, folder, whole=whole)
        return
    work = functools.partial(answer_lines, str(folder))
    with Cluster(cluster, work) if cluster else Processes(workers or _cores(), work, first) as those:
        run = Run(source, those, whole=whole)
        try:
            yield iter(run)
        finally:
            run.close()


def is_error(text: str) -> bool:
    """Whether an answer says that its line could not be answered."""
    return text.startswith('{"error"')


def _here(source: Source, folder: Path, *, whole: bool) -> Iterator[Answered]:
    from handsight.batch.problems import Reader, answer_text

    reader = Reader(folder)
    for lines in blocks(source, whole=whole):
        for line in lines:
            yield Answered([line], [answer_text(reader, line)], [])


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def blocks(source: Source, *, whole: bool = False) -> Iterator[list[bytes]]:
    """The lines that are not blank, without their ends, as many at a time as have come; closes the source."""
    begun: list[bytes] = []
    with source:
        try:
            if whole:
                yield [source.read()]
                return
            while block := source.read1(BLOCK_BYTES):
                *lines, rest = block.split(b"\n")
                if lines:
                    lines[0] = b"".join([*begun, lines[0]])
                    begun.clear()
                    yield [line for line in lines if line.strip()]
                begun.append(rest)
        except OSError as error:
            raise InvalidFile(f"{getattr(source, 'name', 'input')}: {error.strerror or error}") from None
    last = b"".join(begun)
    if last.strip():
        yield [last]


class Run:
    """Iterates over the lines of a source with their answers, a chunk at a time, in order."""

    def __init__(self, source: Source, workers: Processes | Cluster, *, whole: bool = False) -> None:
        """`source` is the run's from here on; `whole`: all of it is one line."""
        self._workers = workers
        self._order: SimpleQueue[tuple[list[bytes], Future[Answers]] | BaseException | None] = SimpleQueue()
        """What was begun, in the order of the lines; at the end an error or None."""
        self._changed = threading.Condition()
        self._running = self._held = 0
        # The first chunks are small, so that a few slow lines are spread over all workers.
        self._size = 1
        self._closing = False
        # A daemon, and never waited for: nothing can interrupt it while it waits for input.
        arguments = (blocks(source, whole=whole),)
        threading.Thread(target=self._read, args=arguments, name="handsight-reader", daemon=True).start()

    def __iter__(self) -> Iterator[Answered]:
        while (begun := self._order.get()) is not None:
            if isinstance(begun, BaseException):
                raise begun
            lines, future = begun
            deaths = self._deaths(future)
            answers = self._tried_alone(lines, deaths) if deaths else future.result()
            yield Answered(lines, answers.texts, answers.warnings)
            with self._changed:
                self._held -= _bytes(lines)
                self._changed.notify()

    def close(self) -> None:
        """Begins nothing more."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    def _read(self, source: Iterator[list[bytes]]) -> None:
        end = None
        try:
            for lines in source:
                while lines and not self._closing:
                    lines = lines[self._begin(lines) :]
        except BaseException as error:  # who waits for the answers must hear of it, whatever it is
            end = error
        self._order.put(end)

    def _begin(self, lines: list[bytes]) -> int:
        """How many of the lines were begun, once there was room."""
        # Not within the lock: a cluster's answer may wait for whoever tells of a chunk's end.
        room = self._workers.room()
        with self._changed:
            self._changed.wait_for(
                lambda: self._closing or (self._held < HELD_BYTES and self._running < room)
            )
            chunk = lines[: self._size]
            if not self._closing:
                future = self._workers.submit(chunk)
                self._held += _bytes(chunk)
                self._running += 1
                self._order.put((chunk, future))
                future.add_done_callback(lambda future: self._ended(len(chunk), future))
        return len(chunk)

    def _ended(self, lines: int, future: Future[Answers]) -> None:
        """Makes room, and chunks that keep a worker busy for as long as it should be."""
        with self._changed:
            self._running -= 1
            if not future.cancelled() and future.exception() is None:
                seconds, aim = future.result().seconds, self._workers.chunk_seconds
                if seconds > 2 * aim:
                    self._size = max(1, min(self._size, lines // 2))
                elif seconds < aim / 2 and lines == self._size:
                    self._size = min(2 * lines, CHUNK_LINES)
            self._changed.notify_all()

    def _deaths(self, future: Future[Answers]) -> int:
        """How many workers died on a chunk, once it has ended; raises WorkerFailure where something else went wrong."""
        try:
            error = future.exception()
        except CancelledError as cancelled:
            error = cancelled
        return 0 if error is None else self._workers.deaths(error)

    def _tried_alone(self, lines: list[bytes], deaths: int) -> Answers:
        """The answers to lines that were lost with a worker, while no others are at work: who dies, dies of these."""
        with self._changed:
            self._changed.wait_for(lambda: not self._running)
            while deaths < DEATHS:
                future = self._workers.submit(lines)
                died = self._deaths(future)
                if not died:
                    return future.result()
                deaths += died
            if len(lines) == 1:
                said = f"line: expected a problem that a worker survives, got {deaths} that died (out of memory?)"
                return Answers([json.dumps({"error": said})], 0.0, [])
            # One of them kills. Each alone may be unlucky, but not as often as a chunk.
            each = [self._tried_alone([line], 1) for line in lines]
        return Answers(
            [text for one in each for text in one.texts], 0.0, [w for one in each for w in one.warnings]
        )


def _bytes(lines: list[bytes]) -> int:
    return sum(len(line) + LINE_BYTES for line in lines)
