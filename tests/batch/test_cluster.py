"""`handsight correct --cluster` on a real scheduler and worker processes of its own, over the loopback."""

import contextlib
import json
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from batch.fragile_worker import obeyed
from handsight.batch import answering
from handsight.batch.problems import Reader, answer_text
from handsight.batch.workers import WorkerFailure

pytest.importorskip("distributed", reason="needs handsight[cluster]")

DATA = Path(__file__).parents[2] / "src/handsight/data"
PATIENCE = 300


def waited_for(condition):
    until = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.02)


def started(folder, name, *arguments):
    with open(folder / f"{name}.log", "wb") as log:
        return subprocess.Popen(
            [sys.executable, "-m", *map(str, arguments)], cwd=folder, stdout=log, stderr=subprocess.STDOUT
        )


@pytest.fixture
def cluster(tmp_path_factory):
    """(address, [worker, worker], scheduler), all processes."""
    with running(tmp_path_factory.mktemp("cluster")) as processes:
        yield processes


@contextlib.contextmanager
def running(folder):
    """A cluster as the fixture's."""
    found = folder / "scheduler.json"
    scheduler = started(
        folder, "scheduler", "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", 0,
        "--no-dashboard", "--scheduler-file", found,
    )  # fmt: skip
    processes = [scheduler]
    try:
        waited_for(lambda: found.exists() and found.read_text().endswith("}"))
        address = json.loads(found.read_text())["address"]
        alone = ("--host", "127.0.0.1", "--nthreads", 1, "--no-nanny", "--no-dashboard")
        for name in ("one", "two"):
            arguments = ("distributed.cli.dask_worker", address, "--name", name, *alone)
            processes.append(started(folder, name, *arguments))
        for name in ("one", "two"):
            waited_for(lambda log=folder / f"{name}.log": b"Registered to" in log.read_bytes())
        yield address, processes[1:], scheduler
    finally:
        for process in processes:
            process.kill()
            process.wait()


def begun(problems, output, address):
    return subprocess.Popen(
        [sys.executable, "-m", "handsight.cli", "correct", str(problems), "--output", str(output),
         "--cluster", address],
        stderr=subprocess.PIPE,
    )  # fmt: skip


def ended(command):
    _, said = command.communicate(timeout=PATIENCE)
    assert b"Traceback" not in said, said.decode()
    return command.returncode, said.decode()


def written(tmp_path, n):
    """Problems that can be told apart, and a bad one in the middle."""
    line = json.loads((DATA / "demo.jsonl").read_text().splitlines()[1])
    lines = []
    for _ in range(n):
        line["vision"]["position"][0] += 1e-5
        lines.append(json.dumps(line))
    lines[n // 2] = '{"object": {"mesh": "none.ply"}, "contacts": [{"point": [0, 0, 0]}]}'
    path = tmp_path / "problems.jsonl"
    path.write_text("\n".join(lines) + "\n")
    return path


def test_a_killed_worker_costs_no_line_and_doubles_none(cluster, tmp_path):
    address, workers, _ = cluster
    problems, output = written(tmp_path, 1500), tmp_path / "answers.jsonl"
    # First, so that the kernels are compiled once and kept.
    reader = Reader(tmp_path.absolute())
    alone = {
        k: answer_text(reader, line)
        for k, line in enumerate(problems.read_bytes().splitlines())
        if k % 10 == 1
    }
    command = begun(problems, output, address)
    part = tmp_path / "answers.jsonl.part"
    waited_for(lambda: part.exists() and part.stat().st_size > 0)
    workers[0].kill()
    code, said = ended(command)
    assert code == 1
    assert "1500 answers, 1 of them errors" in said
    answers = output.read_text().splitlines()
    assert len(answers) == len(set(answers)) == 1500
    assert "object.mesh: none.ply: cannot be read" in json.loads(answers[750])["error"]
    # The next line's vision is 1e-5 away; another process may round otherwise.
    for line, expected in alone.items():
        there, here = (json.loads(text)["position"] for text in (answers[line], expected))
        np.testing.assert_allclose(there, here, rtol=0, atol=1e-9)


def test_a_scheduler_that_is_lost_is_a_sentence(cluster, tmp_path):
    address, those, scheduler = cluster
    source = open(written(tmp_path, 20_000), "rb")  # noqa: SIM115  # closed at its end
    with answering(source, tmp_path.absolute(), cluster=address) as answered:
        next(answered)
        for process in (scheduler, *those):
            process.kill()
        with pytest.raises(WorkerFailure):
            list(answered)


def test_nobody_at_the_address_is_a_sentence(tmp_path):
    with socket.socket() as taken:  # bound, and not listening
        taken.bind(("127.0.0.1", 0))
        address = f"tcp://127.0.0.1:{taken.getsockname()[1]}"
        problems, output = written(tmp_path, 2), tmp_path / "answers.jsonl"
        code, said = ended(begun(problems, output, address))
    assert code == 2
    assert f"{address}: expected a Dask scheduler there, got none" in said
    assert not output.exists()
    code, said = ended(begun(problems, output, "nonsense://here"))
    assert code == 2
    assert "nonsense://here: expected a Dask scheduler there, got none (unknown address scheme" in said


def test_without_dask_the_extra_is_named(monkeypatch):
    from handsight.batch.workers import Cluster
    from handsight.errors import MissingExtra

    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingExtra):
        Cluster("tcp://127.0.0.1:1", obeyed)
