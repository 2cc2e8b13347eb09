"""Many lines through many workers: each is answered once, in its place, whatever happens to the workers."""

import io
import json
import os
import random
import signal
import subprocess
import sys
import threading
from concurrent.futures import Future
from pathlib import Path

import pytest

from batch.fragile_worker import obeyed
from handsight.batch import answering
from handsight.batch.blocks import LONGEST, blocks
from handsight.batch.run import answered_by
from handsight.batch.workers import Answers, Processes, WorkerDied, WorkerFailure
from handsight.errors import InvalidFile


class Pretended:
    """Workers in this process that finish their chunks in any order, and lose some."""

    def __init__(self, *, room=4, loses=lambda lines: False, seed=0):
        self.room, self.loses = room, loses
        self.random = random.Random(seed)
        self.running = self.most = 0

    def submit(self, lines):
        self.running += 1
        self.most = max(self.most, self.running)
        future = Future()
        threading.Timer(0.005 * self.random.random(), self.finish, [lines, future]).start()
        return future

    def finish(self, lines, future):
        self.running -= 1
        if self.loses(lines):
            future.set_exception(WorkerDied())
        else:
            future.set_result(Answers([json.dumps({"line": line.decode()}) for line in lines], []))

    def answers(self, future):
        return future.result()

    def alone(self, line):
        return self.answers(self.submit([line]))


def source(lines):
    return io.BytesIO("".join(f"{line}\n" for line in lines).encode())


def answered(run):
    """Lines and answers in one list; both came in step."""
    pairs = []
    for lines, answers in run:
        pairs += zip([line.decode() for line in lines], map(json.loads, answers.texts), strict=True)
    return pairs


@pytest.mark.parametrize("n", [0, 1, 2, 7, 1000])
def test_every_line_is_answered_once_and_in_order(n):
    rng = random.Random(n)

    def loses(lines):
        return len(lines) > 1 and rng.random() < 0.3

    workers = Pretended(room=3, loses=loses)
    pairs = answered(answered_by(workers, blocks(source(range(n)))))
    assert [line for line, _ in pairs] == [str(i) for i in range(n)]
    assert all(answer["line"] == line for line, answer in pairs)
    assert workers.most <= workers.room + 2  # one is submitted while the queue is full, one is tried again


def test_blank_lines_are_none_and_the_last_needs_no_end():
    found = [line.strip() for lines in blocks(io.BytesIO(b"\n1\n  \n2\r\n\n3")) for line in lines]
    assert found == [b"1", b"2", b"3"]


def test_a_whole_file_is_one_line_even_an_empty_one():
    assert list(blocks(io.BytesIO(b"{\n}\n"), single=True)) == [[b"{\n}\n"]]
    assert list(blocks(io.BytesIO(b""), single=True)) == [[b""]]


class InPieces(io.RawIOBase):
    """Gives what it is asked for a few bytes at a time."""

    def __init__(self, data):
        self.rest = data

    def readable(self):
        return True

    def readinto(self, buffer):
        n = min(3, len(self.rest), len(buffer))
        buffer[:n], self.rest = self.rest[:n], self.rest[n:]
        return n


@pytest.mark.parametrize("text", [b"", b"\n", b"1", b"12345678\n", b"1\n22\n\n333\n4444\n55555\n666666"])
def test_lines_that_come_in_pieces_are_put_together(text):
    came = [line for lines in blocks(io.BufferedReader(InPieces(text))) for line in lines]
    assert came == [line for line in text.split(b"\n") if line]


class Endless(io.BufferedIOBase):
    """Lines without end, counted as they are read."""

    name = "endless"
    read_lines = 0

    def read1(self, size=-1):
        self.read_lines += 10
        return 10 * (b"x" * 1000 + b"\n")


def test_a_line_that_takes_forever_does_not_let_the_reader_run_ahead():
    class Stuck(Pretended):
        def submit(self, lines):
            return Future()

    lines = Endless()
    run = answered_by(Stuck(room=8), blocks(lines))
    threading.Thread(target=lambda: next(run), daemon=True).start()
    before = -1
    while lines.read_lines != before:
        before = lines.read_lines
        threading.Event().wait(0.3)
    assert 0 < before < 1000


def test_an_answer_does_not_wait_for_the_next_line():
    """A program that sends a line and waits for its answer before it sends the next gets it."""
    read, write = os.pipe()
    answers = answered_by(Pretended(), blocks(os.fdopen(read, "rb")))
    for i in range(5):
        os.write(write, f"{i}\n".encode())
        assert next(answers)[0] == [f"{i}".encode()]
    os.close(write)
    assert list(answers) == []


def test_a_file_that_cannot_be_read_on_is_an_error_after_what_could_be_read():
    class Broken(Endless):
        def read1(self, size=-1):
            if self.read_lines:
                raise OSError(5, "Input/output error")
            return super().read1(size)

    came = []
    with pytest.raises(InvalidFile):
        came.extend(line for lines, _ in answered_by(Pretended(), blocks(Broken())) for line in lines)
    assert len(came) == 10


@pytest.mark.parametrize("workers", [1, 2])
def test_a_reader_that_dies_ends_the_run(workers):
    class Dying(io.BytesIO):
        def read1(self, size=-1):
            raise MemoryError

    with answering(Dying(), Path(), workers=workers) as answers, pytest.raises(MemoryError):
        list(answers)


def test_a_long_line_is_cut_a_byte_after_the_limit_and_the_next_is_complete():
    data = b"x" * (LONGEST + 500_000) + b"\nnext\n" + b" " * (LONGEST + 9) + b"y\n" + b"x" * LONGEST
    lengths = [len(line) for lines in blocks(io.BytesIO(data)) for line in lines]
    assert lengths == [LONGEST + 1, 4, LONGEST + 1, LONGEST]


def test_a_mark_of_utf_8_is_dropped_at_the_beginning_only():
    mark = b"\xef\xbb\xbf"
    assert [*blocks(io.BytesIO(mark + b"a\n" + mark + b"b"))] == [[b"a"], [mark + b"b"]]
    assert [*blocks(io.BytesIO(mark + b"\na"))] == [[b"a"]]
    assert [*blocks(io.BytesIO(mark + b"{}"), single=True)] == [[b"{}"]]


def obey(orders, size=2):
    """Runs orders through real worker processes; answers what came back."""
    with Processes(size, obeyed) as workers:
        return answered(answered_by(workers, blocks(source(orders))))


def test_a_worker_that_dies_costs_no_line(tmp_path):
    orders = [f"say {i}" for i in range(200)]
    orders[100] = f"die-once {tmp_path / 'a'}"
    orders[199] = f"die-once {tmp_path / 'b'}"
    pairs = obey(orders)
    assert [line for line, _ in pairs] == orders
    assert [answer["line"] for _, answer in pairs] == orders
    assert len({answer["pid"] for _, answer in pairs}) >= 2


def test_a_line_that_kills_every_worker_is_an_error_in_its_place():
    orders = [f"say {i}" for i in range(60)]
    orders[40] = "die"
    pairs = obey(orders)
    assert [line for line, _ in pairs] == orders
    assert [i for i, (_, answer) in enumerate(pairs) if "error" in answer] == [40]


def test_workers_killed_while_they_wait_are_replaced():
    read, write = os.pipe()
    with Processes(2, obeyed) as workers:
        answers = answered_by(workers, blocks(os.fdopen(read, "rb")))
        pids = []
        for i in range(4):
            os.write(write, f"say {i}\n".encode())
            pids.append(json.loads(next(answers)[1].texts[0])["pid"])
            os.kill(pids[-1], signal.SIGKILL)
        os.close(write)
        assert list(answers) == []
    assert len(set(pids)) == 4


def test_a_line_of_many_megabytes_passes():
    long = "say " + "x" * 20_000_000
    pairs = obey(["say 1", long, "say 2"])
    assert [answer["line"] for _, answer in pairs] == ["say 1", long, "say 2"]


def test_an_error_other_than_a_death_is_raised():
    with pytest.raises(WorkerFailure):
        obey(["say 1", "fail"])


def test_a_worker_ignores_ctrl_c_and_leaves_stdout_alone(capfd):
    _, (_, blocked) = obey(["print", "blocked"], size=1)
    assert blocked["ignores"]
    out, said = capfd.readouterr()
    assert out == ""
    assert "something a library says" in said


def test_leaving_early_ends_the_workers():
    psutil = pytest.importorskip("psutil")
    with Processes(2, obeyed) as workers:
        _, first = next(answered_by(workers, iter([[b"say 1"], [b"sleep 60"], [b"sleep 60"]])))
        processes = [psutil.Process(json.loads(first.texts[0])["pid"])]
    assert not psutil.wait_procs(processes, timeout=10)[1]


def test_workers_end_with_their_parent_however_it_ends(tmp_path):
    psutil = pytest.importorskip("psutil")
    (tmp_path / "parent.py").write_text(
        "from batch.fragile_worker import obeyed\n"
        "from handsight.batch.run import answered_by\n"
        "from handsight.batch.workers import Processes\n"
        "if __name__ == '__main__':\n"
        "    with Processes(2, obeyed) as workers:\n"
        "        for _, answers in answered_by(workers, iter([[b'say'], [b'sleep 60'], [b'sleep 60']])):\n"
        "            print(answers.texts, flush=True)\n"
    )
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(Path(__file__).parents[1]), *sys.path])}
    arguments = [sys.executable, "parent.py"]
    with subprocess.Popen(arguments, cwd=tmp_path, env=environment, stdout=subprocess.PIPE) as parent:
        assert b"say" in parent.stdout.readline()
        children = psutil.Process(parent.pid).children(recursive=True)
        assert len(children) >= 2
        parent.kill()
    assert not psutil.wait_procs(children, timeout=10)[1]
