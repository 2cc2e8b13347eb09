"""`handsight correct` as a user runs it: whole commands, whole files."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

HANDSIGHT = [sys.executable, "-m", "handsight.cli"]
DATA = Path(__file__).parents[2] / "src/handsight/data"

BOX = {
    "object": {"box": [0.06, 0.09, 0.14]},
    "contacts": [
        {"point": [0.030, 0.010, 0.030], "normal": [1, 0, 0], "sigma_point": 0.001, "sigma_normal_deg": 5},
        {"point": [0.030, -0.020, -0.040], "normal": [2, 0, 0]},
        {"point": [-0.010, 0.045, 0.020], "normal": [0, 1, 0]},
        {"point": [0.015, 0.045, -0.030], "normal": [0, 1, 0]},
        {"point": [0.010, 0.020, 0.070], "normal": [0, 0, 1]},
    ],
    "vision": {
        "position": [0.02, -0.01, 0.015],
        "quaternion_xyzw": [0.05, 0.02, -0.04, 2.0],
        "sigma_position": 0.03,
        "sigma_rotation_deg": 15,
    },
}
KEYS = [
    "position",
    "quaternion_xyzw",
    "covariance",
    "information",
    "converged",
    "iterations",
    "seconds",
    "residuals",
    "unobservable",
    "consistent",
    "outliers",
    "hypotheses",
]


def changed(path, value):
    """The box problem with one field, named like `contacts[0].point`, replaced (or removed by `...`)."""
    problem = json.loads(json.dumps(BOX))
    *way, last = path.replace("]", "").replace("[", ".").split(".")
    at = problem
    for step in way:
        at = at[int(step)] if isinstance(at, list) else at[step]
    if value is ...:
        del at[last]
    else:
        at[int(last) if isinstance(at, list) else last] = value
    return problem


def run(*arguments, stdin="", cwd=None, expect=0):
    done = subprocess.run(
        [*HANDSIGHT, *map(str, arguments)],
        input=stdin.encode() if isinstance(stdin, str) else stdin,
        capture_output=True,
        cwd=cwd,
        timeout=120,
        env={**os.environ, "COLUMNS": "100"},
    )
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert done.returncode == expect, done.stderr.decode()
    return done.stdout.decode(), done.stderr.decode()


def corrected(*problems, expect=0):
    lines = [p if isinstance(p, str) else json.dumps(p) for p in problems]
    out, _ = run("correct", "-", stdin="\n".join(lines) + "\n", expect=expect)
    return [json.loads(line) for line in out.splitlines()]


def test_the_box_with_five_contacts_is_put_right():
    (answer,) = corrected(BOX)
    assert list(answer) == KEYS
    np.testing.assert_allclose(answer["position"], 0, atol=2e-3)
    np.testing.assert_allclose(answer["quaternion_xyzw"][:3], 0, atol=0.03)
    assert np.shape(answer["covariance"]) == np.shape(answer["information"]) == (6, 6)
    np.testing.assert_allclose(np.array(answer["covariance"]) @ answer["information"], np.eye(6), atol=1e-6)
    assert answer["converged"]
    assert answer["consistent"]
    assert answer["outliers"] == answer["unobservable"] == []
    assert len(answer["residuals"]["distance"]) == len(answer["residuals"]["normal_deg"]) == 5
    assert answer["hypotheses"][0]["position"] == answer["position"]


def test_answers_keep_the_order_and_errors_stay_in_their_place():
    answers = corrected(BOX, "{not json", changed("contacts[0].point", [0, 0]), BOX, expect=1)
    assert [("error" in a) for a in answers] == [False, True, True, False]
    assert answers[1]["error"].startswith("line: expected JSON")
    assert answers[2]["error"] == "contacts[0].point: expected 3 finite numbers, got [0, 0]"


NAN = float("nan")


@pytest.mark.parametrize(
    ("problem", "error"),
    [
        (
            changed("contacts[0].point", [NAN, 0, 0]),
            "contacts[0].point: expected 3 finite numbers, got [nan, 0, 0]",
        ),
        (changed("contacts[0].point", ["a", 0, 0]), "contacts[0].point: expected 3 finite numbers"),
        (
            changed("contacts[0].point", [True, 0, 0]),
            "contacts[0].point: expected 3 finite numbers, got [True, 0, 0]",
        ),
        (changed("contacts[0].point", [10**400, 0, 0]), "contacts[0].point: expected 3 finite numbers"),
        (changed("contacts[1].point", [1e300, 0, 0]), "contacts[1].point: "),
        (
            changed("contacts[1].normal", [0, 0, 0]),
            "contacts[1].normal: expected a direction, got a zero vector",
        ),
        (changed("contacts[2].sigma_point", 0), "contacts[2].sigma_point: expected a number above 0, got 0"),
        (
            changed("contacts[2].sigma_normal_deg", -5),
            "contacts[2].sigma_normal_deg: expected a number above 0, got -5",
        ),
        (changed("contacts[2].colour", "red"), "contacts[2]: unknown key 'colour'"),
        (changed("contacts", []), "contacts: expected at least one contact, got none"),
        (changed("contacts", {}), "contacts: expected `array`, got {}".replace("`", "")),
        (
            changed("contacts[0].covariance", np.eye(6).tolist()),
            "contacts[0]: expected sigmas or a covariance, got both",
        ),
        (
            changed("contacts[1].covariance", (-np.eye(6)).tolist()),
            "contacts[1].covariance: expected a positive semidefinite",
        ),
        (
            changed("vision.quaternion_xyzw", [0, 0, 0, 0]),
            "vision.quaternion_xyzw: expected a direction, got a zero vector",
        ),
        (
            changed("vision.sigma_position", ...),
            "vision.sigma_position: expected a number above 0, got nothing",
        ),
        (
            changed("vision.sigma_position", float("inf")),
            "vision.sigma_position: expected a finite number, got inf",
        ),
        (
            changed("vision.covariance", np.eye(6).tolist()),
            "vision: expected sigma_position and sigma_rotation_deg or a covariance, got both",
        ),
        (changed("object", {}), "object: expected one of mesh, box, cylinder, got none"),
        (
            changed("object", {"box": [0.1, 0.1, -0.1]}),
            "object.box: expected 3 numbers above 0, got [0.1, 0.1, -0.1]",
        ),
        (changed("object", {"mesh": "no-such-file.ply"}), "object.mesh: "),
        (changed("object", {"box": [0.1, 0.1, 0.1], "scale": 2}), "object.scale: expected beside mesh only"),
        (changed("method", "magic"), "method: expected one of handsight, paper-lm, paper-gd"),
        (changed("samples", -1), "samples: expected a whole number from 0, got -1"),
        (changed("samples", 1.5), "samples: expected a whole number from 0, got 1.5"),
        (changed("outside", [[0, 0]]), "outside: expected finite numbers of shape (n, 3), got [[0, 0]]"),
        (changed("object", ...), "object: expected, got nothing"),
        ({**BOX, "extra": 1}, "line: unknown key 'extra'"),
        ("[1, 2]", "line: expected an object {...}, got [1, 2]"),
        ('{"object": {"box": [1,1,1]}, "object": {"box": [2,2,2]}, "contacts": []}', "object: expected once"),
        ("[" * 100_000, "line: "),
    ],
)
def test_each_wrong_line_names_field_expectation_and_what_came(problem, error):
    (answer,) = corrected(problem, expect=1)
    assert list(answer) == ["error"]
    assert error in answer["error"]


def test_a_contact_without_a_normal_has_no_angle():
    (answer,) = corrected(changed("contacts[4].normal", ...))
    assert answer["residuals"]["normal_deg"][4] is None
    assert answer["residuals"]["normal_deg"][0] is not None


def test_blind_is_a_problem_without_vision():
    problem = changed("vision", ...)
    (answer,) = corrected(problem)
    assert answer["consistent"]
    assert max(map(abs, answer["residuals"]["distance"])) < 0.003
    assert sum(h["weight"] for h in answer["hypotheses"]) == pytest.approx(1)


@pytest.mark.parametrize("method", ["paper-lm", "paper-gd", "paper-lm-distance", "paper-gd-distance"])
def test_the_papers_methods_answer_in_the_same_form(method):
    (answer,) = corrected({**BOX, "method": method})
    assert list(answer) == KEYS


def test_the_papers_methods_ask_for_two_contacts_and_ours_for_one():
    one = changed("contacts", BOX["contacts"][:1])
    ours, papers = corrected(one, {**one, "method": "paper-lm"}, expect=1)
    assert len(ours["unobservable"]) == 3
    assert "at least 2 fingers" in papers["error"]


def test_meshes_are_found_beside_the_problem_file(tmp_path):
    import trimesh

    folder = tmp_path / "problems"
    folder.mkdir()
    trimesh.creation.box((60, 90, 140)).export(folder / "box.stl")
    problem = {**BOX, "object": {"mesh": "box.stl", "scale": 0.001}}
    (folder / "all.jsonl").write_text(json.dumps(problem) + "\n\n" + json.dumps(problem) + "\n")
    run("correct", folder / "all.jsonl", "--output", tmp_path / "answers.jsonl", cwd=tmp_path)
    answers = [json.loads(line) for line in (tmp_path / "answers.jsonl").read_text().splitlines()]
    assert len(answers) == 2
    np.testing.assert_allclose(answers[0]["position"], 0, atol=3e-3)


def test_a_single_json_file_may_span_lines(tmp_path):
    (tmp_path / "one.json").write_text(json.dumps(BOX, indent=2))
    out, _ = run("correct", tmp_path / "one.json")
    assert list(json.loads(out)) == KEYS


def test_the_plot_is_written(tmp_path):
    (tmp_path / "one.json").write_text(json.dumps(BOX))
    run("correct", tmp_path / "one.json", "--output", tmp_path / "a.jsonl", "--plot", tmp_path / "a.png")
    assert (tmp_path / "a.png").read_bytes().startswith(b"\x89PNG")
    assert (tmp_path / "a.png").stat().st_size > 20_000


def test_a_missing_file_and_an_overwritten_one_are_sentences(tmp_path):
    _, said = run("correct", tmp_path / "none.jsonl", expect=2)
    assert "none.jsonl: No such file" in said
    (tmp_path / "p.jsonl").write_text(json.dumps(BOX))
    _, said = run("correct", tmp_path / "p.jsonl", "--output", tmp_path / "p.jsonl", expect=2)
    assert "overwrite" in said
    assert json.loads((tmp_path / "p.jsonl").read_text()) == BOX


def test_bytes_that_are_no_text_are_answered_in_place():
    out, _ = run("correct", "-", stdin=b"\xff\xfe\x00\n" + json.dumps(BOX).encode() + b"\n", expect=1)
    first, second = map(json.loads, out.splitlines())
    assert "UTF-8" in first["error"]
    assert second["converged"]


def test_the_demo_corrects_can_and_box_and_draws_them(tmp_path):
    out, _ = run("demo", "--plot", tmp_path / "demo.png", cwd=tmp_path)
    assert "can" in out
    assert "box" in out
    assert str(tmp_path / "demo.png") in out.replace("\n", "")
    assert (tmp_path / "demo.png").stat().st_size > 20_000


def test_the_demo_takes_most_of_what_touch_can_see():
    from handsight.cli.examples import examples

    for row in examples():
        assert row.shift[0] == pytest.approx(0.08, abs=1e-3)
        assert row.shift_seen[1] < 0.05 * row.shift_seen[0]
        assert row.turn[1] < np.deg2rad(4)


def test_contact_converts_wrenches(tmp_path):
    (tmp_path / "w.csv").write_text("fx,fy,fz,tx,ty,tz\n0,0,-1,0,0,0\n0,0,0.01,0,0,0\n")
    out, said = run("contact", tmp_path / "w.csv", "--fingertip", "ellipsoid:8,8,12mm,cap=-2mm")
    header, touched, free = out.splitlines()
    row = dict(zip(header.split(","), touched.split(","), strict=True))
    assert row["reason"] == "contact"
    assert float(row["z"]) == pytest.approx(0.012)
    assert float(row["nz"]) == pytest.approx(-1)
    assert "free" in free
    assert "1 contact" in said


def test_help_teaches():
    out, _ = run("correct", "--help")
    assert "quaternion_xyzw" in out
    assert "outside" in out
    assert "--workers 0" in out
    assert "--cluster tcp://" in out
    out, _ = run("contact", "--help")
    assert "fx" in out
    assert "ellipsoid:8,8,12mm" in out


def test_version_is_the_packages():
    from importlib.metadata import version

    out, _ = run("--version")
    assert out.strip() == f"handsight {version('handsight')}"


def timeless(text):
    """Answers without how long they took."""
    return re.sub(r'"seconds": [^,]+', "", text)


def test_more_workers_answer_the_same(tmp_path):
    lines = [json.dumps(changed("contacts[0].point", [0.03, 0.001 * i, 0.03])) for i in range(30)]
    lines[7], lines[20] = "{not json", json.dumps(changed("contacts[0].point", [0, 0]))
    (tmp_path / "p.jsonl").write_text("\n".join(lines))  # the last line has no end
    alone, _ = run("correct", tmp_path / "p.jsonl", expect=1)
    _, said = run("correct", tmp_path / "p.jsonl", "--output", tmp_path / "a.jsonl", "--workers", 2, expect=1)
    assert timeless((tmp_path / "a.jsonl").read_text()) == timeless(alone)
    assert "30 answers, 2 of them errors" in said
    out, _ = run("correct", "-", "--workers", 0, stdin="\n".join(lines), expect=1)
    assert timeless(out) == timeless(alone)


def test_workers_find_meshes_draw_and_warn_once(tmp_path):
    import trimesh

    folder = tmp_path / "problems"
    folder.mkdir()
    trimesh.creation.box((60, 90, 140)).export(folder / "huge.stl")  # millimetres, and no scale
    line = json.dumps({**BOX, "object": {"mesh": "huge.stl"}})
    missing = json.dumps({**BOX, "object": {"mesh": "none.stl"}})
    (folder / "all.jsonl").write_text(f"{line}\n{missing}\n{line}\n{line}\n")
    out, said = run(
        "correct", "problems/all.jsonl", "--plot", "a.png", "--workers", 2, cwd=tmp_path, expect=1
    )
    assert ["error" in json.loads(a) for a in out.splitlines()] == [False, True, False, False]
    assert said.count("scale") == 1, said
    assert (tmp_path / "a.png").stat().st_size > 20_000


def begun(arguments, **streams):
    """The command, running; SIGINT works in it as in a shell's foreground, whatever the tests' own runner ignores."""
    return subprocess.Popen(
        [sys.executable, "-c", "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
         "from handsight.cli import main; main()", *map(str, arguments)],
        stderr=subprocess.PIPE,
        **streams,
    )  # fmt: skip


def several(path, n, **more):
    path.write_text((json.dumps({**BOX, **more}) + "\n") * n)
    return path


def waited_for(condition, seconds=100):
    until = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


@pytest.mark.parametrize("workers", [1, 2])
def test_ctrl_c_keeps_what_was_answered_and_leaves_nobody_behind(tmp_path, workers):
    import psutil

    problems, output = several(tmp_path / "p.jsonl", 100_000), tmp_path / "a.jsonl"
    command = begun(["correct", problems, "--output", output, "--workers", workers])
    waited_for(lambda: output.exists() and output.stat().st_size > 10_000)
    children = psutil.Process(command.pid).children(recursive=True)
    assert len(children) == (0 if workers == 1 else workers)
    command.send_signal(signal.SIGINT)
    _, said = command.communicate(timeout=60)
    assert command.returncode == 130
    assert b"Traceback" not in said
    answers = output.read_text().splitlines()
    stopped = int(re.search(rb"stopped after (\d+) answers; they are written", said)[1])
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


def test_a_worker_that_is_killed_costs_no_line(tmp_path):
    import psutil

    problems, output = several(tmp_path / "p.jsonl", 400), tmp_path / "a.jsonl"
    command = begun(["correct", problems, "--output", output, "--workers", 2])
    waited_for(lambda: output.exists() and output.stat().st_size > 10_000)
    for child in psutil.Process(command.pid).children(recursive=True):
        child.kill()
    _, said = command.communicate(timeout=120)
    assert command.returncode == 0, said
    answers = output.read_text().splitlines()
    assert len(answers) == 400
    assert all(list(json.loads(answer)) == KEYS for answer in answers)


def test_a_fault_of_ours_costs_its_line_only(monkeypatch):
    from handsight.batch import problems

    def faulty(problem):
        raise ZeroDivisionError("no")

    monkeypatch.setattr(problems, "answer", faulty)
    text = problems.answer_text(problems.Reader(Path()), json.dumps(BOX).encode())
    assert "line: expected an answer, got ZeroDivisionError: no" in json.loads(text)["error"]


def test_workers_and_cluster_exclude_each_other():
    _, said = run("correct", "-", "--workers", 2, "--cluster", "tcp://127.0.0.1:1", expect=2)
    assert "--workers: expected without --cluster" in said


@pytest.mark.parametrize(
    "arguments", [["--help"], ["--version"], ["correct", "--help"], ["warmup", "--help"]]
)
def test_help_and_version_load_nothing_heavy(arguments):
    program = (
        "import sys\n"
        f"sys.argv = ['handsight', *{arguments}]\n"
        "from handsight.cli import main\n"
        "try: main()\n"
        "except SystemExit as end: assert not end.code\n"
        "heavy = {'numpy', 'numba', 'scipy', 'trimesh', 'dask', 'distributed', 'matplotlib', 'msgspec', 'rich.progress'}\n"
        "assert not heavy & set(sys.modules), heavy & set(sys.modules)\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=60)
    assert done.returncode == 0, done.stderr.decode()


def test_every_public_name_is_there_when_asked_for():
    import pickle
    import typing

    import handsight as hs

    assert set(hs.__all__) <= set(dir(hs))
    for name in hs.__all__:
        value = getattr(hs, name)
        assert pickle.loads(pickle.dumps(value)) is value or typing.get_args(value)
    everything = {}
    exec("from handsight import *", everything)
    assert set(hs.__all__) <= set(everything)
    assert hs.se3.compose
    with pytest.raises(AttributeError, match="'handsight' has no attribute 'nothing'"):
        _ = hs.nothing


def test_editors_and_users_see_the_same_names():
    """What type checkers read in `__init__` is what is loaded."""
    import ast

    import handsight as hs

    tree = ast.parse(Path(hs.__file__).read_text())
    promised = {
        alias.name: node.module
        for block in tree.body if isinstance(block, ast.If)
        for node in block.body if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }  # fmt: skip
    assert sorted(promised) == sorted(hs.__all__)
    for name, module in promised.items():
        assert getattr(hs, name) is getattr(sys.modules[module], name)


def test_warmup_says_what_it_compiled_and_where_it_is(monkeypatch, capsys):
    import types

    from handsight._kernels import compiled
    from handsight.cli.main import warmup

    warm = types.ModuleType("handsight._kernels.warm")
    warm.warm = lambda report: (report("fields", 1.25), report("solver", 20.0))
    monkeypatch.setitem(sys.modules, "handsight._kernels.warm", warm)
    warmup()
    out, said = capsys.readouterr()
    assert said.splitlines() == ["   1.2 s  fields", "  20.0 s  solver"]
    assert re.match(r"compiled in \d\.\d s; kept in ", out)
    assert str(compiled.folder()) in out
