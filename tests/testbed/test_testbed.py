"""The room that experiments and benchmarks share, and who may import whom among them."""

import ast
import os
from pathlib import Path

import pytest

from cli.commands import called
from handsight.simulation import Scenario
from testbed import report, ycb
from testbed.recordings import record

ROOT = Path(__file__).parents[2]


def imported(folder):
    """(file, module) of every import in a folder's files."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ImportFrom):
                yield path.relative_to(ROOT).as_posix(), node.module
            elif isinstance(node, ast.Import):
                yield from ((path.relative_to(ROOT).as_posix(), alias.name) for alias in node.names)


def test_experiments_and_benchmarks_import_neither_the_command_line_nor_each_other():
    commands = {"benchmarks/golden/commands.py"}  # its subject is the command line
    for folder in ("experiments", "benchmarks", "testbed"):
        wrong = {file for file, module in imported(folder) if module.startswith("handsight.cli")}
        assert wrong <= commands
    others = {"shared", "experiments", *(path.stem for path in (ROOT / "experiments").glob("*.py"))}
    for folder in ("benchmarks", "testbed"):
        assert not [pair for pair in imported(folder) if pair[1].split(".")[0] in others]
    assert not [pair for pair in imported("testbed") if pair[1].split(".")[0] == "benchmarks"]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--trials", "1"], "argument --trials: expected a whole number of at least 2, got '1'"),
        (["--trials", "x"], "argument --trials: expected a whole number of at least 2, got 'x'"),
        (["--seed", "-1"], "argument --seed: expected a whole number of at least 0, got '-1'"),
        (["--shift-mm", "nan"], "argument --shift-mm: expected a number of at least 0, got 'nan'"),
        (["--output", os.devnull], f"argument --output: {os.devnull}: File exists"),
    ],
)
def test_wrong_arguments_of_an_experiment_are_rejected_in_a_sentence(arguments, message, monkeypatch, capsys):
    parser = report.parser("An experiment.")
    parser.add_argument("--shift-mm", type=report.amount)
    monkeypatch.setattr("sys.argv", ["experiment.py", *arguments])
    with pytest.raises(SystemExit):
        report.parsed(parser, trials=100, quick_trials=6)
    assert capsys.readouterr().err.splitlines()[-1].endswith(f"error: {message}")


def test_a_recording_is_the_one_that_the_command_writes(tmp_path, monkeypatch):
    record(Scenario(object="box", seed=2), tmp_path / "own.mcap")
    options = ("--seed", "2", "--motion", "grasp")
    assert called(monkeypatch, tmp_path, "simulate", "box", *options, "-o", "box.mcap") == 0
    for suffix in (".mcap", ".rig.yaml"):
        own, theirs = ((tmp_path / name).with_suffix(suffix) for name in ("own.mcap", "box.mcap"))
        assert own.read_bytes() == theirs.read_bytes()


def test_without_data_an_experiment_says_so_and_ends_well(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("HANDSIGHT_DATA", str(tmp_path))
    with pytest.raises(SystemExit) as ended:
        ycb.data_or_goodbye()
    assert ended.value.code == 0
    assert f"HANDSIGHT_DATA={tmp_path} has no ycb_meshes" in capsys.readouterr().out


def test_a_detail_is_shown_and_left_out_of_the_manual(capsys):
    for name, detail in (("kept", False), ("aside", True)):
        report.print_table(name, "a | b", [["x", 1]], detail=detail)
    shown = capsys.readouterr()
    assert "kept" in shown.out
    assert "aside" not in shown.out
    assert "aside" in shown.err
