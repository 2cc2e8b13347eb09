"""Many lines, many workers: read as they come, answered anywhere, handed on in order, never all in memory.

A thread reads ahead a little; a crew (worker processes of this machine, or a cluster) answers chunks of lines and
says so in a queue of events; all decisions fall in the caller's thread, in `Stream`.
"""

import json
import threading
from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass
from queue import SimpleQueue
from typing import IO, NamedTuple, Protocol

from handsight.errors import HandsightError, InvalidFile

CHUNK_LINES = 256
CHUNK_BYTES = 256_000
AHEAD_BYTES = 4_000_000
"""Lines read before a worker asks for them."""
HELD_BYTES = 64_000_000
"""Lines and answers that wait for an earlier line's answer; above it nothing more is begun."""
LINE_BYTES = 200
"""What Python spends on a line besides its characters."""
DEATHS = 3
"""Workers that may die on the same lines before the lines are to blame."""


class Answers(NamedTuple):
    """What a worker made of a chunk."""

    texts: list[str]
    """One line of JSON for each line, without its end."""
    seconds: float
    notes: list[str]
    """Warnings, for the terminal."""


@dataclass
class Chunk:
    """Consecutive lines that one worker answers at a time."""

    first: int
    """Number of its first line."""
    lines: list[bytes]
    deaths: int = 0
    """Workers that have died on it."""


@dataclass(frozen=True)
class Done:
    """A chunk was answered."""

    chunk: Chunk
    answers: Answers


@dataclass(frozen=True)
class Died:
    """A chunk was lost with the worker that had it."""

    chunk: Chunk
    workers: int = 1


@dataclass(frozen=True)
class Failed:
    """Nothing more can be answered."""

    error: HandsightError


Events = SimpleQueue[Done | Died | Failed | None]
"""None: lines have come, or will come no more."""


class Crew(Protocol):
    """Who answers chunks, and says so in the events."""

    chunk_seconds: float
    """How long a worker should be busy with one chunk."""

    def room(self) -> int:
        """How many chunks it takes at the same time."""

    def put(self, chunk: Chunk) -> None:
        """Begins a chunk; an event follows."""


def is_error(text: str) -> bool:
    """Whether an answer says that its line could not be answered."""
    return text.startswith('{"error"')


class Feed:
    """The lines of a file, read ahead by a thread, so that a slow source holds up no answer."""

    def __init__(self, source: IO[bytes], events: Events, *, whole: bool = False) -> None:
        """`source` is the feed's from here on; `whole`: all of it is one line."""
        self._source, self._events, self._whole = source, events, whole
        self._lines: deque[bytes] = deque()
        self._held = 0
        self._over = self._asked = False
        self._changed = threading.Condition()
        # A daemon, and never waited for: nothing can interrupt it while it waits for input.
        threading.Thread(target=self._read, name="handsight-reader", daemon=True).start()

    @property
    def ended(self) -> bool:
        """Whether every line was taken."""
        with self._changed:
            return self._over and not self._lines

    def take(self, most: int) -> list[bytes]:
        """The next lines, as many as have come; none: an event tells of the next."""
        taken: list[bytes] = []
        size = 0
        with self._changed:
            while self._lines and len(taken) < most and size < CHUNK_BYTES:
                taken.append(self._lines.popleft())
                size += len(taken[-1]) + LINE_BYTES
            self._held -= size
            self._asked = not taken
            self._changed.notify()
        return taken

    def _read(self) -> None:
        try:
            with self._source:
                for line in lines_of(self._source, whole=self._whole):
                    self._add(line)
        except OSError as error:
            said = f"{getattr(self._source, 'name', 'input')}: {error.strerror or error}"
            self._events.put(Failed(InvalidFile(said)))
        with self._changed:
            self._over = True
        self._events.put(None)

    def _add(self, line: bytes) -> None:
        with self._changed:
            while self._held > AHEAD_BYTES:
                self._changed.wait()
            self._lines.append(line)
            self._held += len(line) + LINE_BYTES
            if self._asked:
                self._asked = False
                self._events.put(None)


def lines_of(source: IO[bytes], *, whole: bool) -> Iterator[bytes]:
    """The lines that are not blank."""
    if whole:
        yield source.read()
        return
    for line in source:
        if line.strip():
            yield line


class Stream:
    """Iterates over a feed's lines with their answers, a chunk at a time, in order."""

    def __init__(self, feed: Feed, crew: Crew, events: Events) -> None:
        """The crew and the feed tell `events`."""
        self.feed, self.crew, self.events = feed, crew, events
        self.notes: deque[str] = deque()
        """Warnings that have come; whoever shows them takes them out."""
        self._again: deque[Chunk] = deque()
        self._done: dict[int, Done] = {}
        self._running = self._held = self._read = self._handed = 0
        # The first chunks are small, so that a few slow lines are spread over all workers.
        self._size = 1

    def __iter__(self) -> Iterator[tuple[list[bytes], list[str]]]:
        while True:
            while (done := self._done.pop(self._handed, None)) is not None:
                self._handed += len(done.chunk.lines)
                self._held -= _size(done.chunk.lines) + _size(done.answers.texts)
                yield done.chunk.lines, done.answers.texts
            while self._running < self.crew.room() and (chunk := self._next()) is not None:
                self._running += 1
                self.crew.put(chunk)
            if self._handed == self._read and self.feed.ended:
                return
            self._take(self.events.get())

    def _next(self) -> Chunk | None:
        if self._again:
            return self._again.popleft()
        if self._held >= HELD_BYTES:
            return None
        lines = self.feed.take(self._size)
        if not lines:
            return None
        chunk = Chunk(self._read, lines)
        self._read += len(lines)
        self._held += _size(lines)
        return chunk

    def _take(self, event: Done | Died | Failed | None) -> None:
        match event:
            case Failed(error):
                raise error
            case Done(chunk, answers):
                self._running -= 1
                self._keep(chunk, answers)
                self._adapt(len(chunk.lines), answers.seconds)
            case Died(chunk, workers):
                self._running -= 1
                self._retry(chunk, workers)

    def _keep(self, chunk: Chunk, answers: Answers) -> None:
        self.notes.extend(answers.notes)
        self._held += _size(answers.texts)
        self._done[chunk.first] = Done(chunk, answers)

    def _adapt(self, lines: int, seconds: float) -> None:
        aim = self.crew.chunk_seconds
        if seconds > 2 * aim:
            self._size = max(1, min(self._size, lines // 2))
        elif seconds < aim / 2 and lines == self._size:
            self._size = min(2 * lines, CHUNK_LINES)

    def _retry(self, chunk: Chunk, workers: int) -> None:
        chunk.deaths += workers
        if chunk.deaths < DEATHS:
            self._again.append(chunk)
        elif len(chunk.lines) > 1:
            # One of them kills. Each alone may be unlucky, but not as often as a chunk.
            for i, line in enumerate(chunk.lines):
                self._again.append(Chunk(chunk.first + i, [line], deaths=1))
        else:
            said = f"line: expected a problem that a worker survives, got {chunk.deaths} that died (out of memory?)"
            self._keep(chunk, Answers([json.dumps({"error": said})], 0.0, []))


def _size(lines: list[bytes] | list[str]) -> int:
    return sum(len(line) + LINE_BYTES for line in lines)
