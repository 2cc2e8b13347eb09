"""A file of problems answered: by this process, by others on this machine, or by a cluster; in order, as they come."""

import contextlib
import os
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from queue import SimpleQueue
from typing import IO

from handsight.batch.run import Crew, Events, Feed, Stream, is_error, lines_of
from handsight.cli.terminal import opened_input, warn

MOST_PANELS = 6
"""Problems that a picture has room for."""
Answered = tuple[list[bytes], list[str]]
"""Lines and their answers."""


class Tally:
    """What has been written."""

    def __init__(self) -> None:
        self.done = self.failed = 0
        self.first: list[tuple[bytes, str]] = []
        """What a picture can show."""

    def write(self, answers: Iterable[Answered], sink: IO[str], advance: Callable[[int, int], None]) -> None:
        """Writes answers as they come."""
        for lines, texts in answers:
            sink.write("".join(f"{text}\n" for text in texts))
            # Before the flush: once in the buffer, answers are written whatever interrupts us.
            self.done += len(texts)
            self.failed += sum(map(is_error, texts))
            sink.flush()
            if len(self.first) < MOST_PANELS:
                pairs = zip(lines, texts, strict=True)
                good = [pair for pair in pairs if not is_error(pair[1])]
                self.first += good[: MOST_PANELS - len(self.first)]
            advance(len(texts), sum(map(len, lines)))


@contextlib.contextmanager
def answered(problems: str, folder: str, workers: int, cluster: str | None) -> Iterator[Iterable[Answered]]:
    """The lines with their answers, in order: from this process, from others, from a cluster."""
    whole = problems.endswith(".json")
    if workers == 1 and cluster is None:
        from handsight.batch.problems import Reader, answer_text

        reader = Reader(Path(folder))
        with opened_input(problems) as source:
            yield (([line], [answer_text(reader, line)]) for line in lines_of(source, whole=whole))
        return
    source = opened_input(problems)
    events: Events = SimpleQueue()
    with _crew(folder, workers, cluster, events) as crew:
        work = Stream(Feed(source, events, whole=whole), crew, events)
        yield _noting(work)


def _crew(
    folder: str, workers: int, cluster: str | None, events: Events
) -> contextlib.AbstractContextManager[Crew]:
    if cluster is not None:
        from handsight.batch.cluster import Cluster

        return Cluster(cluster, folder, events)
    from handsight.batch.crew import Processes

    return Processes(workers or _cores(), folder, events)


def _cores() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _noting(work: Stream) -> Iterator[Answered]:
    """The same answers; what workers warn of is said."""
    for answered in work:
        while work.notes:
            warn(work.notes.popleft())
        yield answered
