"""A worker as `handsight.batch.worker`, but its lines are orders: what a test needs to go wrong goes wrong."""

import json
import os
import signal
import time
from pathlib import Path

from handsight.batch import worker


def obeyed(reader, line):
    order, _, rest = line.decode().strip().partition(" ")
    if order == "die":
        os.kill(os.getpid(), signal.SIGKILL)
    if order == "die-once" and not (mark := Path(rest)).exists():
        mark.touch()
        os.kill(os.getpid(), signal.SIGKILL)
    if order == "sleep":
        time.sleep(float(rest))
    return json.dumps({"line": line.decode().strip(), "pid": os.getpid()})


if __name__ == "__main__":
    worker.answer_text = obeyed
    worker.main()
