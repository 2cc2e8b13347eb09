"""`handsight correct` as a user runs it: whole files, many workers, Ctrl-C."""

import json
import re
import signal
import subprocess

import numpy as np
import pytest

from batch.box_problem import BOX, KEYS, changed
from cli.commands import begun, corrected, run, waited_for


def test_answers_keep_the_order_and_errors_stay_in_their_place():
    answers = corrected(BOX, "{not json", changed("contacts[0].point", [0, 0]), BOX, expect=1)
    assert [("error" in a) for a in answers] == [False, True, True, False]
    assert answers[1]["error"].startswith("line: expected JSON")
    assert answers[2]["error"] == "contacts[0].point: expected 3 finite numbers, got [0, 0]"


def test_meshes_are_found_beside_the_problem_file(asked, tmp_path):
    import trimesh

    folder = tmp_path / "problems"
    folder.mkdir()
    trimesh.creation.box((60, 90, 140)).export(folder / "box.stl")
    problem = {**BOX, "object": {"mesh": "box.stl", "scale": 0.001}}
    (folder / "all.jsonl").write_text(json.dumps(problem) + "\n\n" + json.dumps(problem) + "\n")
    asked("correct", folder / "all.jsonl", "--output", tmp_path / "answers.jsonl")
    answers = [json.loads(line) for line in (tmp_path / "answers.jsonl").read_text().splitlines()]
    assert len(answers) == 2
    np.testing.assert_allclose(answers[0]["position"], 0, atol=3e-3)


def test_a_single_json_file_may_span_lines(asked, tmp_path):
    (tmp_path / "one.json").write_text(json.dumps(BOX, indent=2))
    out, _ = asked("correct", tmp_path / "one.json")
    assert list(json.loads(out)) == KEYS


def test_a_missing_file_and_an_overwritten_one_are_sentences(asked, tmp_path):
    _, said = asked("correct", tmp_path / "none.jsonl", expect=2)
    assert "none.jsonl: No such file" in said
    (tmp_path / "p.jsonl").write_text(json.dumps(BOX))
    _, said = asked("correct", tmp_path / "p.jsonl", "--output", tmp_path / "p.jsonl", expect=2)
    assert "overwrite" in said
    assert json.loads((tmp_path / "p.jsonl").read_text()) == BOX


def timeless(text):
    """Answers without how long they took."""
    return re.sub(r'"seconds": [^,]+', "", text)


def test_more_workers_answer_the_same(tmp_path):
    lines = [json.dumps(changed("contacts[0].point", [0.03, 0.001 * i, 0.03])) for i in range(30)]
    lines[7], lines[20] = "{not json", json.dumps(changed("contacts[0].point", [0, 0]))
    (tmp_path / "p.jsonl").write_text("\n".join(lines))  # the last line has no end
    # In a process of its own: the one that compiles a kernel may round otherwise than those that load it.
    alone, _ = run("correct", tmp_path / "p.jsonl", expect=1)
    _, said = run("correct", tmp_path / "p.jsonl", "--output", tmp_path / "a.jsonl", "--workers", 2, expect=1)
    assert timeless((tmp_path / "a.jsonl").read_text()) == timeless(alone)
    assert "30 answers, 2 of them errors" in said
    out, _ = run("correct", "-", "--workers", 0, stdin="\n".join(lines), expect=1)
    assert timeless(out) == timeless(alone)


def workers_of(command):
    """Its worker processes, without what Python's multiprocessing has beside them."""
    import psutil

    children = psutil.Process(command.pid).children(recursive=True)
    return [child for child in children if "spawn_main" in " ".join(child.cmdline())]


def several(path, n, **more):
    path.write_text((json.dumps({**BOX, **more}) + "\n") * n)
    return path


@pytest.mark.parametrize(("workers", "sent"), [(1, signal.SIGINT), (2, signal.SIGINT), (1, signal.SIGTERM)])
def test_ctrl_c_keeps_what_was_answered_beside_an_earlier_file_and_leaves_nobody_behind(
    tmp_path, workers, sent
):
    import psutil

    problems, output = several(tmp_path / "p.jsonl", 100_000), tmp_path / "a.jsonl"
    output.write_text("as it was")
    command = begun(["correct", problems, "--output", output, "--workers", workers])
    part = output.with_name("a.jsonl.part")
    waited_for(lambda: part.exists() and part.stat().st_size > 10_000)
    children = psutil.Process(command.pid).children(recursive=True)
    assert len(workers_of(command)) == (0 if workers == 1 else workers)
    command.send_signal(sent)
    _, said = command.communicate(timeout=60)
    assert command.returncode == 130
    assert b"Traceback" not in said
    assert output.read_text() == "as it was"
    answers = part.read_text().splitlines()
    stopped = int(re.search(rb"stopped after (\d+) answers; they are in \S+a.jsonl.part", said)[1])
    assert 0 < stopped <= len(answers) < 100_000
    assert all(list(json.loads(answer)) == KEYS for answer in answers)
    assert not psutil.wait_procs(children, timeout=30)[1]


def test_ctrl_c_while_it_waits_for_stdin():
    command = begun(["correct", "-", "--workers", 2], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    command.stdin.write(json.dumps(BOX).encode() + b"\n")
    command.stdin.flush()
    # The answer comes though more lines may follow.
    assert list(json.loads(command.stdout.readline())) == KEYS
    command.send_signal(signal.SIGINT)
    assert command.wait(timeout=60) == 130
    said = command.communicate()[1]
    # An answer is counted once it is written, so one may be out that is not counted yet.
    assert re.fullmatch(r"handsight: stopped after [01] answers; they are written\n", said.decode())


@pytest.mark.parametrize("workers", [1, 2])
def test_a_reader_that_leaves_ends_it_quietly(tmp_path, workers):
    problems = several(tmp_path / "p.jsonl", 100_000)
    command = begun(["correct", problems, "--workers", workers], stdout=subprocess.PIPE)
    assert list(json.loads(command.stdout.readline())) == KEYS
    command.stdout.close()
    assert command.stderr.read() == b""
    assert command.wait(timeout=60) == 141
    command.stderr.close()


def test_workers_and_cluster_exclude_each_other(asked):
    _, said = asked("correct", "-", "--workers", 2, "--cluster", "tcp://127.0.0.1:1", expect=2)
    assert "--workers: expected without --cluster" in said


def test_the_plot_is_written(asked, tmp_path):
    (tmp_path / "one.json").write_text(json.dumps(BOX))
    asked("correct", tmp_path / "one.json", "--output", tmp_path / "a.jsonl", "--plot", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.png").stat().st_size > 20_000
