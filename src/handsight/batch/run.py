"""Lines answered by many workers: read as they come, answered in order, never all in memory."""

import contextlib
import functools
import json
import signal
import threading
from collections.abc import Iterator
from pathlib import Path
from queue import Queue
from typing import Any

from handsight.batch.blocks import Source, blocks
from handsight.batch.workers import Answers, Cluster, Processes, WorkerDied, answer_lines

CHUNK_LINES = 16
"""Lines in a chunk: some milliseconds of work, a hundred times what sending it takes."""
Answered = tuple[list[bytes], Answers]
"""Consecutive lines with their answers."""


@contextlib.contextmanager
def answering(
    source: Source, folder: Path, *, single: bool = False, workers: int = 1, cluster: str | None = None
) -> Iterator[Iterator[Answered]]:
    """Yields an iterator over the lines with their answers, in order.

    They are answered by this process (`workers` 1), by that many worker processes (0: one for each core), or by the
    Dask cluster at an address. `source` is closed at its end. `single`: the entire source is one line. `folder`:
    absolute; relative paths of meshes start here. Raises WorkerFailure, InvalidFile.
    """
    if workers == 1 and cluster is None:
        from handsight.batch.problems import Reader, answer_text

        reader = Reader(folder)
        lines = (line for block in blocks(source, single=single) for line in block)
        yield (([line], Answers([answer_text(reader, line)], [])) for line in lines)
        return
    import numba

    available = numba.config.NUMBA_DEFAULT_NUM_THREADS
    work = functools.partial(answer_lines, str(folder))
    with Cluster(cluster, work) if cluster else Processes(workers or available, work) as those:
        yield answered_by(those, blocks(source, single=single))


def answered_by(workers: Processes | Cluster, blocks: Iterator[list[bytes]]) -> Iterator[Answered]:
    """Yields lines with their answers, in order; what reading or submitting raises is raised after these.

    One thread reads and submits, until `workers.room` chunks wait for their answers. The lines of a chunk whose worker
    died are tried again, each by itself; one of which two more workers die is answered with an error.
    """
    waiting: Queue[tuple[list[bytes], Any] | BaseException | None] = Queue(workers.room)

    def read() -> None:
        """Reads and submits; processes that this thread starts inherit its signals, and Ctrl-C is not theirs."""
        if hasattr(signal, "pthread_sigmask"):
            signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        end = None
        try:
            for lines in blocks:
                for first in range(0, len(lines), CHUNK_LINES):
                    chunk = lines[first : first + CHUNK_LINES]
                    waiting.put((chunk, workers.submit(chunk)))
        except BaseException as error:  # of any kind: the thread that waits for the answers must get it
            end = error
        waiting.put(end)

    # A daemon thread, never joined, as nothing can interrupt it while it waits for input.
    threading.Thread(target=read, name="handsight-reader", daemon=True).start()
    while isinstance(item := waiting.get(), tuple):
        lines, future = item
        try:
            yield lines, workers.answers(future)
        except WorkerDied:
            yield from (([line], _tried_again(workers, line)) for line in lines)
    if item is not None:
        raise item


def _tried_again(workers: Processes | Cluster, line: bytes) -> Answers:
    """Returns the answer to a line whose chunk lost its worker; an error where two more die of the line alone."""
    for _ in range(2):  # the line may not have been begun when another one's worker died
        with contextlib.suppress(WorkerDied):
            return workers.alone(line)
    message = "line: expected a problem that a worker survives, got two that died (out of memory?)"
    return Answers([json.dumps({"error": message})], [])
