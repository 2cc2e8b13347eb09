"""A bounded queue of messages, from the threads that receive them to the one that reads them."""

import threading
from collections import Counter, deque

from handsight.messages import RawMessage


class Inbox:
    """An `Inbox` is a bounded queue of messages: of too many, the oldest are dropped, and counted."""

    def __init__(self, max_waiting: int = 20_000, max_bytes: int = 1 << 28) -> None:
        self._max_waiting, self._max_bytes = max_waiting, max_bytes
        self.dropped = Counter[str]()
        """Number of dropped messages by topic."""
        self._waiting, self._bytes = deque[tuple[float, RawMessage]](), 0
        self._filled = threading.Condition()

    def put(self, message: RawMessage, now: float) -> None:
        """Adds a message that came at `now`, by `time.monotonic`; from any thread."""
        with self._filled:
            self._waiting.append((now, message))
            self._bytes += len(message.data)
            while len(self._waiting) > self._max_waiting or self._bytes > self._max_bytes:
                _, oldest = self._waiting.popleft()
                self._bytes -= len(oldest.data)
                self.dropped[oldest.topic] += 1
            self._filled.notify()

    def wake(self) -> None:
        """Lets a `take` that waits return."""
        with self._filled:
            self._filled.notify()

    def take(self, timeout: float) -> list[tuple[float, RawMessage]]:
        """Returns all messages, each with the time at which it came; waits at most `timeout` [s] for the first."""
        with self._filled:
            if not self._waiting and timeout > 0:
                self._filled.wait(timeout)
            taken, self._waiting, self._bytes = self._waiting, deque(), 0
        return list(taken)
