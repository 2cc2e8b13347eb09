"""Messages that wait for the one thread that reads them."""

import threading
from collections import Counter, deque

from handsight.messages import RawMessage

MAX_WAITING, MAX_WAITING_BYTES = 20_000, 1 << 28


class Inbox:
    """An `Inbox` is a bounded queue: of too many messages the oldest are dropped, and counted."""

    def __init__(self) -> None:
        self.dropped = Counter[str]()
        """By topic."""
        self._waiting, self._bytes = deque[tuple[float, RawMessage]](), 0
        self._filled = threading.Condition()

    def put(self, message: RawMessage, now: float) -> None:
        """Takes in a message that came `now`; from any thread."""
        with self._filled:
            self._waiting.append((now, message))
            self._bytes += len(message.data)
            while len(self._waiting) > MAX_WAITING or self._bytes > MAX_WAITING_BYTES:
                _, oldest = self._waiting.popleft()
                self._bytes -= len(oldest.data)
                self.dropped[oldest.topic] += 1
            self._filled.notify()

    def wake(self) -> None:
        """Ends a `take` that waits."""
        with self._filled:
            self._filled.notify()

    def take(self, timeout: float) -> list[tuple[float, RawMessage]]:
        """Returns all that wait, each with when it came; waits at most `timeout` [s] for the first."""
        with self._filled:
            if not self._waiting and timeout > 0:
                self._filled.wait(timeout)
            taken, self._waiting, self._bytes = self._waiting, deque(), 0
        return list(taken)
