"""The command `handsight` and its small commands, and what importing the package loads."""

import os
import pty
import re
import subprocess
import sys

import numpy as np
import pytest
import typer

from cli.commands import called, read_some, run
from handsight.cli.main import app


def test_help_teaches(asked):
    out, _ = asked("correct", "--help")
    assert "quaternion_xyzw" in out
    assert "outside" in out
    assert "--workers 0" in out
    assert "--cluster tcp://" in out
    out, _ = asked("contact", "--help")
    assert "fx" in out
    assert "ellipsoid:8,8,12mm" in out


def test_version_is_the_packages():
    from importlib.metadata import version

    out, _ = run("--version")
    assert out.strip() == f"handsight {version('handsight')}"


def commands():
    """Each command by its name, with its parameters."""

    def below(command, name):
        if not hasattr(command, "commands"):
            yield name, command
        for key, each in getattr(command, "commands", {}).items():
            yield from below(each, f"{name} {key}".strip())

    return dict(below(typer.main.get_command(app), ""))


@pytest.mark.parametrize("name", commands())
def test_every_command_teaches(name):
    """A sentence on what it does, an example as one types it, and a help text for each option."""
    command = commands()[name]
    assert re.match(r"[A-Z][^.]+[.,:;]", command.help)
    assert f"\nhandsight {name} " in command.help or f"\nhandsight {name}\n" in command.help
    for parameter in command.params:
        assert parameter.hidden or len(parameter.help) > 5, parameter.name


@pytest.mark.parametrize("name", commands())
def test_no_asterisk_of_a_help_text_is_lost(name):
    """Help texts are Markdown: between two asterisks text is slanted, and they vanish, but not within backquotes."""
    command = commands()[name]
    for text in (command.help, *(parameter.help or "" for parameter in command.params)):
        plain = re.sub(r"```.*?```|`[^`]*`|\*\*", "", text, flags=re.DOTALL)
        assert "*" not in re.sub(r"^ *\* ", "", plain, flags=re.MULTILINE)  # but of a list


def test_o_is_a_file_v_says_more_and_no_other_option_is_one_letter():
    for name, command in commands().items():
        for option in command.params:
            if "-o" in option.opts and not option.hidden:
                assert option.opts == ["--output", "-o"]
                assert option.help.startswith("File for the"), name
            else:
                assert "-o" in option.opts or {opt for opt in option.opts if len(opt) == 2} <= {"-v"}


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
        assert isinstance(value, str) or pickle.loads(pickle.dumps(value)) is value or typing.get_args(value)
    everything = {}
    exec("from handsight import *", everything)
    assert set(hs.__all__) <= set(everything)
    assert hs.se3.compose
    with pytest.raises(AttributeError):
        _ = hs.nothing


def test_contact_converts_wrenches(asked, tmp_path):
    (tmp_path / "w.csv").write_text("fx,fy,fz,tx,ty,tz\n0,0,-1,0,0,0\n0,0,0.01,0,0,0\n")
    out, said = asked("contact", tmp_path / "w.csv", "--fingertip", "ellipsoid:8,8,12mm,cap=-2mm")
    header, touched, free = out.splitlines()
    row = dict(zip(header.split(","), touched.split(","), strict=True))
    assert row["reason"] == "contact"
    assert float(row["z"]) == pytest.approx(0.012)
    assert float(row["nz"]) == pytest.approx(-1)
    assert "free" in free
    assert "1 contact" in said


def test_the_demo_corrects_can_and_box_and_draws_them(asked, tmp_path):
    out, _ = asked("demo", "--plot", tmp_path / "demo.png")
    assert "can" in out
    assert "box" in out
    assert str(tmp_path / "demo.png") in out.replace("\n", "")
    assert (tmp_path / "demo.png").stat().st_size > 20_000


def test_without_a_terminal_the_demo_says_once_that_it_compiles(asked, monkeypatch):
    from handsight._compiled.jit import on_compile
    from handsight.cli import demo

    def compiles():
        for name in ("one", "", "two", ""):
            for announce in on_compile:
                announce(name)
        return []

    monkeypatch.setattr(demo, "examples", compiles)
    monkeypatch.setattr(demo, "draw_corrections", lambda *_: "")
    monkeypatch.setattr(demo, "find_can", lambda *_: [])
    monkeypatch.setattr(demo, "replays", lambda *_: [])
    _, said = asked("demo")
    assert len([line for line in said.splitlines() if "compiling" in line]) == 1


def test_the_demo_removes_most_of_the_error_that_touch_observes():
    from handsight.cli.demo import examples

    for row in examples():
        assert row.vision.shift == pytest.approx(0.08, abs=1e-3)
        assert row.corrected.shift_observable < 0.05 * row.vision.shift_observable
        assert row.corrected.turn < np.deg2rad(4)


def test_the_demo_finds_the_can_in_a_picture_with_the_hand_before_it(tmp_path):
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    from handsight.cli.demo import find_can

    said, wrote = find_can(tmp_path / "picture.png")
    found = re.search(r"\(synthetic\): centre off by ([\d.]+) mm, axis by ([\d.]+)°", said)
    assert float(found[1]) < 10
    assert float(found[2]) < 5
    assert wrote == f"wrote {tmp_path / 'picture.png'}"
    assert (tmp_path / "picture.png").stat().st_size > 20_000


def test_without_an_extra_the_demo_says_so_and_goes_on(asked, monkeypatch):
    from handsight.cli import demo
    from handsight.errors import MissingExtra

    def missing(*_):
        raise MissingExtra("images need pillow: pip install 'handsight[vision]'")

    monkeypatch.setattr(demo, "replays", missing)
    monkeypatch.setattr(demo, "picture", missing)
    out, _ = asked("demo", columns=200)
    for said in ("no image searched", "no recordings replayed"):
        assert f"{said}: images need pillow: pip install 'handsight[vision]'" in " ".join(out.split())


BAR = """
from handsight.cli.terminal import bar

with bar("correcting") as move:
    for share in (None, 0.5, 1.0):
        move(share, "12 answers, 3/s")
"""


def test_a_bar_on_a_terminal_shows_what_is_done():
    ours, its = pty.openpty()
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    done = subprocess.Popen([sys.executable, "-c", BAR], stdout=its, stderr=its, env=environment)
    os.close(its)
    text = "".join(iter(lambda: read_some(ours), ""))
    os.close(ours)
    assert done.wait() == 0, text
    assert "correcting" in text
    assert "12 answers, 3/s" in text


KERNEL = """
from handsight._compiled.jit import entry
from handsight.cli.terminal import announce_compiling

@entry
def twice(x):
    return 2 * x

announce_compiling()
assert twice(1) == twice(1.0) == 2
"""


def test_compiling_is_said_once_on_a_terminal_and_only_where_something_is_compiled(tmp_path):
    (tmp_path / "kernel.py").write_text(KERNEL)

    def said(cache, *, terminal):
        environment = {
            **os.environ,
            "NUMBA_CACHE_DIR": str(tmp_path / cache),
            "PYTHONPATH": os.pathsep.join(sys.path),
        }
        ours, its = pty.openpty() if terminal else os.pipe()
        done = subprocess.Popen([sys.executable, tmp_path / "kernel.py"], stderr=its, env=environment)
        os.close(its)
        text = "".join(iter(lambda: read_some(ours), ""))
        os.close(ours)
        assert done.wait() == 0
        return text.split("\r\x1b[2K")  # each replaces the one before

    assert said("piped", terminal=False) == [""]
    begin, *lines, end = said("seen", terminal=True)
    assert begin == end == ""
    assert any(lines)
    assert all(
        line.startswith("compiling handsight's kernels, once on this machine: ") for line in lines if line
    )
    assert said("seen", terminal=True) == [""]


@pytest.mark.parametrize(
    "command",
    [
        "correct -",
        "contact - --fingertip sphere:8mm",
        "track none.mcap",
        "demo",
        "locate none.png",
        "simulate none",
        "calibrate camera none.mcap",
    ],
)
def test_every_command_that_computes_announces_compiling(command, monkeypatch, tmp_path):
    def announced(**_):
        raise SystemExit("announced")

    for module in ("correct", "contact", "options", "demo", "locate", "simulate"):
        monkeypatch.setattr(f"handsight.cli.{module}.announce_compiling", announced)
    assert called(monkeypatch, tmp_path, *command.split()) == "announced"
