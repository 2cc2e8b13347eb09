"""Whole commands, as a user runs them."""

import json
import os
import subprocess
import sys
import time

import pytest

from handsight.cli import main

HANDSIGHT = [sys.executable, "-m", "handsight.cli"]
INTERRUPTIBLE = [
    sys.executable, "-c", "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
    "from handsight.cli import main; main()"
]  # fmt: skip
"""The same; SIGINT works in it as in a shell's foreground, whatever the tests' own runner ignores."""


def run(*arguments, stdin="", cwd=None, expect=0, columns=100):
    """stdout and stderr of a command that ends as expected, and never with a traceback."""
    done = subprocess.run(
        [*HANDSIGHT, *map(str, arguments)],
        input=stdin.encode() if isinstance(stdin, str) else stdin,
        capture_output=True,
        cwd=cwd,
        timeout=300,  # a first run compiles
        env={**os.environ, "COLUMNS": str(columns)},
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert done.returncode == expect, done.stdout.decode() + done.stderr.decode()
    return done.stdout.decode(), done.stderr.decode()


def called(monkeypatch, folder, *arguments, columns=80):
    """The exit code of a command that runs in this process."""
    monkeypatch.chdir(folder)
    monkeypatch.setenv("COLUMNS", str(columns))
    monkeypatch.setattr(sys, "argv", ["handsight", *map(str, arguments)])
    with pytest.raises(SystemExit) as ended:
        main()
    return ended.value.code or 0


def corrected(*problems, expect=0):
    """The answers of `handsight correct -` to problems, or to lines as they stand."""
    lines = [p if isinstance(p, str) else json.dumps(p) for p in problems]
    out, _ = run("correct", "-", stdin="\n".join(lines) + "\n", expect=expect)
    return [json.loads(line) for line in out.splitlines()]


def begun(arguments, **streams):
    """A command, running."""
    return subprocess.Popen([*INTERRUPTIBLE, *map(str, arguments)], stderr=subprocess.PIPE, **streams)


def waited_for(condition, seconds=100):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


def read_some(terminal):
    """What comes next from a terminal; empty at its end."""
    try:
        return os.read(terminal, 4096).decode(errors="replace")
    except OSError:  # how Linux ends a terminal
        return ""
