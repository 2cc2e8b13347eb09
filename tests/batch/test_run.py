"""Many lines through many workers: each is answered once, in its place, whatever happens to the workers."""

import io
import json
import os
import random
import signal
import threading
from queue import SimpleQueue

import pytest

from handsight.batch import crew
from handsight.batch import run as stream
from handsight.batch.crew import CrewFailure, Processes
from handsight.batch.run import Answers, Chunk, Died, Done, Feed, Stream, is_error


class Pretended:
    """A crew in this process that finishes its chunks in any order, and loses some."""

    chunk_seconds = 0.1

    def __init__(self, events, *, size=4, seconds=0.0, loses=lambda chunk: False, seed=0):
        self.events, self.size, self.seconds, self.loses = events, size, seconds, loses
        self.random = random.Random(seed)
        self.begun = []

    def room(self):
        return self.size

    def put(self, chunk):
        self.begun.append(len(chunk.lines))
        threading.Timer(0.005 * self.random.random(), self.finish, [chunk]).start()

    def finish(self, chunk):
        if self.loses(chunk):
            self.events.put(Died(chunk))
        else:
            texts = [json.dumps({"line": line.decode()}) for line in chunk.lines]
            self.events.put(Done(chunk, Answers(texts, self.seconds, [])))


class Prompt(Pretended):
    """Finishes at once."""

    def put(self, chunk):
        self.begun.append(len(chunk.lines))
        self.finish(chunk)


def source(lines):
    return io.BytesIO("".join(f"{line}\n" for line in lines).encode())


def answered(work):
    """Lines and answers in one list; both came in step."""
    pairs = []
    for lines, texts in work:
        pairs += zip([line.decode().strip() for line in lines], map(json.loads, texts), strict=True)
    return pairs


@pytest.mark.parametrize("kind", [Prompt, Pretended])
@pytest.mark.parametrize("n", [0, 1, 2, 7, 3000])
def test_every_line_is_answered_once_and_in_order(kind, n):
    events = SimpleQueue()
    rng = random.Random(n)
    hands = kind(events, size=3 if n > 7 else 1, loses=lambda chunk: chunk.deaths == 0 and rng.random() < 0.3)
    pairs = answered(Stream(Feed(source(range(n)), events), hands, events))
    assert [line for line, _ in pairs] == [str(i) for i in range(n)]
    assert all(answer["line"].strip() == line for line, answer in pairs)


def test_blank_lines_are_none_and_the_last_needs_no_end():
    events = SimpleQueue()
    feed = Feed(io.BytesIO(b"\n1\n  \n2\r\n\n3"), events)
    assert [line for line, _ in answered(Stream(feed, Prompt(events), events))] == ["1", "2", "3"]


def test_a_whole_file_is_one_line():
    events = SimpleQueue()
    feed = Feed(io.BytesIO(b"{\n}\n"), events, whole=True)
    assert [line for line, _ in answered(Stream(feed, Prompt(events), events))] == ["{\n}"]


def test_chunks_are_small_at_first_and_grow_while_they_are_quick():
    events = SimpleQueue()
    hands = Prompt(events, size=1)
    feed = Feed(source(range(5000)), events)
    feed_all(feed)
    answered(Stream(feed, hands, events))
    assert hands.begun[:5] == [1, 2, 4, 8, 16]
    assert max(hands.begun) == stream.CHUNK_LINES


def test_slow_lines_go_one_by_one():
    events = SimpleQueue()
    hands = Prompt(events, size=1, seconds=0.3)
    answered(Stream(Feed(source(range(20)), events), hands, events))
    assert hands.begun == [1] * 20


def feed_all(feed):
    """Waits until the reader is at the end or at its limit."""
    for _ in range(500):
        with feed._changed:
            if feed._over or feed._held > stream.AHEAD_BYTES:
                return
        threading.Event().wait(0.01)


class Counted:
    """Endless lines, counted as they are read."""

    name = "endless"

    def __init__(self):
        self.read = 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        pass

    def __iter__(self):
        while self.read < 10**6:
            self.read += 1
            yield b"x" * 1000 + b"\n"


def test_a_line_that_takes_forever_does_not_let_the_reader_run_ahead(monkeypatch):
    monkeypatch.setattr(stream, "HELD_BYTES", 1_000_000)
    monkeypatch.setattr(stream, "AHEAD_BYTES", 100_000)
    events, lines = SimpleQueue(), Counted()

    class Stuck(Prompt):
        def put(self, chunk):
            if chunk.first > 0:
                super().put(chunk)

    work = iter(Stream(Feed(lines, events), Stuck(events), events))
    threading.Thread(target=lambda: next(work), daemon=True).start()
    before = -1
    while lines.read != before:
        before = lines.read
        threading.Event().wait(0.3)
    assert 100 < lines.read < 2000


def test_an_answer_does_not_wait_for_the_next_line():
    """A program that sends a line and waits for its answer before it sends the next gets it."""
    read, write = os.pipe()
    events = SimpleQueue()
    work = iter(Stream(Feed(os.fdopen(read, "rb"), events), Prompt(events), events))
    for i in range(5):
        os.write(write, f"{i}\n".encode())
        lines, _ = next(work)
        assert lines == [f"{i}\n".encode()]
    os.close(write)
    assert list(work) == []


def test_a_file_that_cannot_be_read_on_is_an_error():
    class Broken(Counted):
        def __iter__(self):
            yield b"1\n"
            raise OSError(5, "Input/output error")

    events = SimpleQueue()
    with pytest.raises(stream.InvalidFile, match="endless: Input/output error"):
        list(Stream(Feed(Broken(), events), Prompt(events), events))


@pytest.fixture
def fragile(monkeypatch):
    """Runs orders through real worker processes; answers what came back."""
    monkeypatch.setattr(crew, "PROGRAM", "batch.fragile_worker")

    def run(orders, size=2):
        events = SimpleQueue()
        with Processes(size, ".", events) as hands:
            return answered(Stream(Feed(source(orders), events), hands, events))

    return run


def test_a_worker_that_dies_costs_no_line(fragile, tmp_path):
    orders = [f"say {i}" for i in range(200)]
    orders[100] = f"die-once {tmp_path / 'a'}"
    orders[199] = f"die-once {tmp_path / 'b'}"
    pairs = fragile(orders)
    assert [line for line, _ in pairs] == orders
    assert [answer["line"] for _, answer in pairs] == orders
    assert len({answer["pid"] for _, answer in pairs}) >= 2


def test_a_line_that_kills_every_worker_is_an_error_in_its_place(fragile):
    orders = [f"say {i}" for i in range(60)]
    orders[40] = "die"
    pairs = fragile(orders)
    assert [line for line, _ in pairs] == orders
    for i, (_, answer) in enumerate(pairs):
        assert ("error" in answer) == (i == 40)
    assert "line: expected a problem that a worker survives, got 3 that died" in pairs[40][1]["error"]
    assert is_error(json.dumps(pairs[40][1]))


def test_workers_killed_while_they_wait_are_replaced(monkeypatch):
    monkeypatch.setattr(crew, "PROGRAM", "batch.fragile_worker")
    read, write = os.pipe()
    events = SimpleQueue()
    with Processes(2, ".", events) as hands:
        work = Stream(Feed(os.fdopen(read, "rb"), events), hands, events)
        answers = iter(work)
        pids = []
        for i in range(4):
            os.write(write, f"say {i}\n".encode())
            pids.append(json.loads(next(answers)[1][0])["pid"])
            os.kill(pids[-1], signal.SIGKILL)
        os.close(write)
        assert list(answers) == []
    assert len(set(pids)) == 4


def test_a_line_of_many_megabytes_passes(fragile):
    long = "say " + "x" * 20_000_000
    pairs = fragile(["say 1", long, "say 2"])
    assert [answer["line"] for _, answer in pairs] == ["say 1", long, "say 2"]


def test_workers_that_cannot_start_are_an_error(monkeypatch, capfd):
    monkeypatch.setattr(crew, "PROGRAM", "no_such_program")
    events = SimpleQueue()
    with (
        Processes(2, ".", events) as hands,
        pytest.raises(CrewFailure, match=r"end as they start \(exit code 1\)"),
    ):
        list(Stream(Feed(source(["1"]), events), hands, events))


def test_leaving_early_ends_the_workers(monkeypatch):
    monkeypatch.setattr(crew, "PROGRAM", "batch.fragile_worker")
    events = SimpleQueue()
    with Processes(2, ".", events) as hands:
        work = iter(Stream(Feed(source(["say 1", "sleep 60", "sleep 60"]), events), hands, events))
        _, (text,) = next(work)
        processes = [worker.process for worker in hands._workers]
    assert json.loads(text)["line"] == "say 1"
    assert processes
    assert all(process.returncode is not None for process in processes)


def test_a_killed_chunk_is_taken_apart():
    events = SimpleQueue()
    work = Stream(Feed(io.BytesIO(), events), Prompt(events), events)
    work._take(Died(Chunk(0, [b"a", b"b"]), workers=3))
    assert [(chunk.first, chunk.lines) for chunk in work._again] == [(0, [b"a"]), (1, [b"b"])]
