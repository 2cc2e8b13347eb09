"""What a worker does: chunks of lines in, answers out. `python -m handsight.batch.worker` is one that `crew` starts."""

import contextlib
import os
import pickle
import sys
import threading
import time
import warnings
from pathlib import Path

from handsight.batch.problems import Reader, answer_text
from handsight.batch.run import Answers

_readers: dict[str, Reader] = {}
# One chunk at a time in a process: neither the models kept nor the kernels' threads are made to be shared.
_alone = threading.Lock()


def answer_lines(folder: str, lines: list[bytes]) -> Answers:
    """The answers to lines whose meshes are in `folder`; models are built once in a process."""
    with _alone, warnings.catch_warnings(record=True) as caught:
        reader = _readers.setdefault(folder, Reader(Path(folder)))
        began = time.perf_counter()
        texts = [answer_text(reader, line) for line in lines]
        seconds = time.perf_counter() - began
    return Answers(texts, seconds, [str(warning.message) for warning in caught])


def main() -> None:
    """Answers pickled lists of lines from stdin on stdout, until there are no more or nobody listens."""
    # Whatever a library prints must not come between the answers.
    outbox = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    inbox = sys.stdin.buffer
    with contextlib.suppress(EOFError, BrokenPipeError, pickle.UnpicklingError):
        folder = pickle.load(inbox)
        pickle.dump("ready", outbox)
        outbox.flush()
        while True:
            pickle.dump(answer_lines(folder, pickle.load(inbox)), outbox)
            outbox.flush()
    os._exit(0)  # what could not be sent is not tried again


if __name__ == "__main__":
    main()
