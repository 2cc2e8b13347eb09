"""Work for worker processes whose lines are orders: what a test needs to go wrong goes wrong."""

import json
import os
import signal
import time
from pathlib import Path

from handsight.batch.workers import Answers


def obeyed(lines):
    """The answers to a chunk of orders, each with the process that gave it."""
    texts = []
    for line in lines:
        order, _, rest = line.decode().strip().partition(" ")
        if order == "die":
            os.kill(os.getpid(), signal.SIGKILL)
        if order == "die-once" and not (mark := Path(rest)).exists():
            mark.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if order == "sleep":
            time.sleep(float(rest))
        if order == "fail":
            raise RuntimeError("no")
        if order == "print":
            print("something a library says", flush=True)
        said = {"line": line.decode().strip(), "pid": os.getpid()}
        if order == "blocked":
            said["ignores"] = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
        texts.append(json.dumps(said))
    return Answers(texts, [])
