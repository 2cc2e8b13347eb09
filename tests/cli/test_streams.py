"""What the system refuses a command: streams that are closed, disks that are full, files that are its own input."""

import json
import os
import shlex
import subprocess
from pathlib import Path

import pytest

from batch.box_problem import BOX, KEYS
from cli.commands import HANDSIGHT, run

WRENCHES = "fx,fy,fz,tx,ty,tz\n" + "0,0,-1,0,0,0\n" * 500
TIP = ("--fingertip", "sphere:8mm")


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "p.jsonl").write_text((json.dumps(BOX) + "\n") * 20)
    (tmp_path / "w.csv").write_text(WRENCHES)
    return tmp_path


def shell(line, folder, *, blocks=None):
    """The exit code and stderr of a command in a shell, where a file may have so many blocks of 512 bytes or 1 kB."""
    # Python 3.11 would leave the bytecode of a module cut short.
    limit = "" if blocks is None else f"export PYTHONDONTWRITEBYTECODE=1; ulimit -f {blocks}; "
    command = limit + line.replace("handsight", shlex.join(HANDSIGHT), 1)
    done = subprocess.run(["sh", "-c", command], cwd=folder, stderr=subprocess.PIPE, timeout=300)
    assert b"Traceback" not in done.stderr, done.stderr.decode()
    assert b"Exception ignored" not in done.stderr
    return done.returncode, done.stderr.decode()


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("handsight --version >&-", "stdout: cannot be written: Bad file descriptor"),
        ("handsight correct --help >&-", "stdout: cannot be written: Bad file descriptor"),
        ("handsight correct p.jsonl >&-", "stdout: cannot be written: Bad file descriptor"),
        ("handsight correct - <&-", "stdin: Bad file descriptor"),
        ("handsight contact - --fingertip sphere:8mm <&-", "stdin: cannot be read: Bad file descriptor"),
        (
            "handsight contact w.csv --fingertip sphere:8mm >&-",
            "stdout: cannot be written: Bad file descriptor",
        ),
    ],
)
def test_a_closed_stream_is_an_error_in_a_sentence(folder, line, said):
    code, err = shell(line, folder)
    assert (code, err) == (2 if "stdin" in said else 74, f"handsight: {said}\n")


def test_a_folder_is_an_error_in_a_sentence(folder, asked):
    _, said = asked("correct", folder, expect=2)
    assert said == f"handsight: {folder}: Is a directory\n"
    _, said = asked("contact", folder, *TIP, expect=2)
    assert said == f"handsight: {folder}: cannot be read: Is a directory\n"


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no /dev/full")
@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("handsight --version > /dev/full", "No space left on device"),
        ("handsight correct p.jsonl > /dev/full", "stdout: cannot be written: No space left on device"),
        (
            "handsight correct p.jsonl -o /dev/full --workers 2",
            "/dev/full: cannot be written: No space left on device",
        ),
        ("handsight contact w.csv --fingertip sphere:8mm > /dev/full", "stdout: cannot be written: No space"),
        (
            "handsight contact w.csv --fingertip sphere:8mm -o /dev/full",
            "/dev/full: cannot be written: No space",
        ),
        ("handsight correct /dev/zero", "/dev/zero: expected a file, a pipe or a terminal, got a device"),
        ("handsight contact /dev/zero --fingertip sphere:8mm", "/dev/zero: line 1: expected at most"),
    ],
)
def test_a_full_device_and_one_without_an_end_are_errors_in_a_sentence(folder, line, said):
    code, err = shell(line, folder)
    assert code == (2 if "/dev/zero" in line else 74)
    assert said in err
    assert err.count("\n") == 1


def test_a_file_that_cannot_grow_is_an_error_and_the_answers_until_then_have_another_name(folder):
    code, err = shell("handsight correct p.jsonl -o a.jsonl", folder, blocks=8)
    assert (code, err) == (74, "handsight: a.jsonl: cannot be written: File too large\n")
    whole = (folder / "a.jsonl.part").read_text().splitlines()[:-1]
    assert whole
    assert all(list(json.loads(line)) == KEYS for line in whole)
    code, err = shell("handsight contact w.csv --fingertip sphere:8mm -o c.csv", folder, blocks=8)
    assert (code, err) == (74, "handsight: c.csv: cannot be written: File too large\n")
    assert sorted(path.name for path in folder.iterdir()) == ["a.jsonl.part", "p.jsonl", "w.csv"]


def test_a_new_rig_that_cannot_be_written_leaves_nothing(folder):
    before = sorted(folder.iterdir())
    code, err = shell("handsight rig new --like allegro -o a.yaml", folder, blocks=1)
    assert (code, err) == (74, "handsight: a.yaml: cannot be written: File too large\n")
    assert sorted(folder.iterdir()) == before


def test_a_picture_that_cannot_grow_is_an_error_in_a_sentence(folder):
    (folder / "one.json").write_text(json.dumps(BOX))
    code, err = shell("handsight correct one.json -o a.jsonl --plot a.png", folder, blocks=20)
    assert (code, err) == (74, "handsight: a.png: cannot be written: File too large\n")
    assert list(json.loads((folder / "a.jsonl").read_text())) == KEYS


def test_a_recording_that_cannot_grow_is_an_error_in_a_sentence(folder):
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    code, err = shell("handsight simulate can --motion grasp -o can.mcap", folder, blocks=32)
    assert code == 74
    assert err.splitlines()[-1] == "handsight: can.mcap: cannot be written: File too large"


def test_a_closed_stderr_changes_no_exit_code(folder):
    assert shell("handsight correct none.jsonl 2>&-", folder)[0] == 2
    if Path("/dev/full").exists():
        assert shell("handsight correct none.jsonl 2>/dev/full", folder)[0] == 2


@pytest.mark.parametrize("link", [os.link, os.symlink])
def test_the_input_is_never_written_over(folder, asked, link):
    problems, wrenches = folder / "p.jsonl", folder / "w.csv"
    before = problems.read_bytes(), wrenches.read_bytes()
    link(problems, folder / "other.jsonl")
    link(wrenches, folder / "other.csv")
    link(problems, growing := folder / "a.jsonl.part")
    for arguments in (
        ("correct", problems, "-o", folder / "other.jsonl"),
        ("correct", folder / "other.jsonl", "-o", problems),
        ("correct", problems, "-o", folder / "a.jsonl", "--plot", folder / "other.jsonl"),
        ("correct", growing, "-o", folder / "a.jsonl"),
        ("contact", wrenches, "-o", wrenches, *TIP),
        ("contact", wrenches, "-o", folder / "other.csv", *TIP),
    ):
        _, said = asked(*arguments, expect=2)
        assert "would overwrite" in said
    assert (problems.read_bytes(), wrenches.read_bytes()) == before
    assert not (folder / "a.jsonl").exists()


def test_nor_is_what_comes_by_stdin_or_goes_to_stdout(folder):
    before = (folder / "p.jsonl").read_bytes(), (folder / "w.csv").read_bytes()
    for line in (
        "handsight correct - -o p.jsonl < p.jsonl",
        "handsight correct p.jsonl >> p.jsonl",
        "handsight contact - -o w.csv --fingertip sphere:8mm < w.csv",
        "handsight contact w.csv --fingertip sphere:8mm >> w.csv",
    ):
        code, err = shell(line, folder)
        assert code == 2
        assert "would overwrite" in err
    assert ((folder / "p.jsonl").read_bytes(), (folder / "w.csv").read_bytes()) == before


def test_a_pipe_is_a_place_for_problems(folder):
    os.mkfifo(folder / "pipe")
    code, err = shell("cat p.jsonl > pipe & handsight correct pipe > a.jsonl", folder)
    assert (code, err) == (0, "")
    assert len((folder / "a.jsonl").read_text().splitlines()) == 20


def test_tables_are_in_utf_8_whatever_the_terminal_is(folder):
    (folder / "w.csv").write_text("finger,fx,fy,fz,tx,ty,tz\nкончик,0,0,-1,0,0,0\n", encoding="utf-8")
    line = "PYTHONIOENCODING=ascii PYTHONUTF8=0 LC_ALL=C handsight contact - --fingertip sphere:8mm < w.csv > c.csv"
    code, err = shell(line, folder)
    assert (code, err) == (0, "1 contact\n")
    assert "кончик,contact," in (folder / "c.csv").read_text(encoding="utf-8")


def test_a_line_longer_than_any_problem_is_an_error_in_its_place():
    from handsight.batch.blocks import LONGEST

    box = json.dumps(BOX).encode()
    for workers in (1, 2):
        out, _ = run(
            "correct",
            "-",
            "--workers",
            workers,
            stdin=box + b"\n" + bytes(2 * LONGEST) + b"\n" + box,
            expect=1,
        )
        first, long, last = map(json.loads, out.splitlines())
        assert long == {"error": f"line: expected at most {LONGEST} bytes, got more"}
        assert list(first) == list(last) == KEYS
