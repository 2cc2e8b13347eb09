"""`handsight objects`, and objects by name in other commands, as a user runs them."""

import json

import pytest

from cli.commands import corrected, run
from handsight.cli.options import Run
from handsight.errors import InvalidInput
from handsight.objects import Facts, Library
from objects.libraries import block, bop, off_text, served
from objects.object_shapes import prism

ADDED = ("--mass", "0.25", "--center-of-mass", "-0.01", "0", "0.02", "--sigma-center-of-mass", "0.005")
SAID = ("--licence", "CC BY 4.0", "--source", "a drawing \x1b[2J")


@pytest.fixture
def library(tmp_path, monkeypatch, asked):
    """A library that the environment names, in which `handsight objects add` has put a block and a can."""
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    block(tmp_path)
    vertices, faces = prism(48, 33.0, 122.0)
    (tmp_path / "can.off").write_text(off_text(vertices, faces))
    _, said = asked("objects", "add", "block.off", "--name", "block", *ADDED, *SAID)
    assert f"added block to {tmp_path}/library as obj_000001.ply: diameter 176.9 mm" in said
    _, said = asked(
        "objects",
        "add",
        "can.off",
        "--name",
        "can",
        "--scale",
        "0.001",
        "--symmetry",
        "z",
        "--symmetry",
        "x/2",
    )
    assert "symmetries: about [0, 0, 1], ends alike" in said
    return tmp_path / "library"


def test_what_was_added_is_listed_and_shown(library, asked):
    out, _ = asked("objects", "list")
    rows = out.splitlines()
    assert rows[0].split() == ["name", "symmetries", "licence", "number", "diameter", "[mm]", "mass", "[g]"]
    assert rows[1].split() == ["block", "none", "CC", "BY", "4.0", "1", "176.9", "250"]
    assert rows[2].split()[0] == "can"
    out, _ = asked("objects", "show", "block")
    shown = dict(line.split("  ", 1) for line in out.splitlines())
    shown = {key: value.strip() for key, value in shown.items()}
    assert shown["size"] == "60.0 x 90.0 x 140.0 mm"
    assert shown["centre of mass"] == "[-10.0, 0.0, 20.0] mm ± 5.0 mm per axis"
    assert shown["licence"] == "CC BY 4.0"
    assert shown["source"] == "a drawing \\x1b[2J"
    assert len(shown["SHA-256"]) == 64
    assert asked("objects", "show", "2", "--library", str(library))[0].startswith("name            can\n")


def test_verify_says_what_is_wrong_and_ends_with_1(library, asked):
    out, _ = asked("objects", "verify")
    assert out == f"{library}: 2 objects are as they should be\n"
    size = (library / "models/obj_000001.ply").stat().st_size
    (library / "models/obj_000001.ply").write_bytes(b"ply\n")
    (library / "models/obj_000002.ply").unlink()
    out, _ = asked("objects", "verify", expect=1)
    assert out.splitlines() == [
        f"- {library}/models/obj_000001.ply: expected {size} bytes, got 4: changed since it was added",
        f"- {library}/models/obj_000002.ply: cannot be read: No such file or directory",
    ]
    out, _ = asked("objects", "show", "block", expect=1)
    assert out.splitlines()[-1].endswith("changed since it was added")


def test_a_library_is_fetched_and_used_without_the_network(library, asked, monkeypatch, tmp_path):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "cache"))
    with served(library) as (url, _):
        _, said = asked("objects", "fetch", url)
        assert said == f"fetched 2 objects; --library or HANDSIGHT_LIBRARY={url} uses them from here\n"
    assert "can " in asked("objects", "list", "--library", url)[0]
    asked("objects", "verify", "--library", url)
    (library / "models/obj_000002.ply").unlink()
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "another"))  # the file itself is in the first one
    with served(library) as (url, _):
        out, said = asked("objects", "fetch", url, expect=1)
        assert out == f"- {url}/models/obj_000002.ply: cannot be read: no such file\n"
        assert said.startswith("fetched 1 objects")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("add", "block.off", "--name", "block"), "name: expected a new one, got 'block', which is that of object 1"),
        (("add", "block.off", "--name", "../b"), "name: expected up to 100 letters"),
        (("add", "none.off", "--name", "b"), "none.off: cannot be read: No such file"),
        (("add", "block.off", "--name", "b", "--symmetry", "z/7"), "--symmetry: expected turns that leave the surface in place"),
        (("add", "block.off", "--name", "b", "--library", "https://x"), "https://x: expected a folder to add to"),
        (("show", "blok"), "got 'blok'; the nearest valid one is 'block'"),
        (("list", "--library", "nowhere"), "nowhere: expected a library, with models/models_info.json, got none"),
        (("fetch", "library"), "library: expected a URL"),
    ],
)  # fmt: skip
def test_what_cannot_be_done_is_one_sentence(library, asked, arguments, said):
    _, wrong = asked("objects", *arguments, expect=2)
    assert wrong.startswith("handsight: ")
    assert said in wrong
    assert len(wrong.splitlines()) == 1


def test_a_full_disk_ends_an_add_with_its_own_code(library, asked, monkeypatch):
    import errno
    import os

    from handsight.objects.library import folder

    def full(_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(folder.os, "fsync", full)
    _, said = asked("objects", "add", "block.off", "--name", "b", expect=74)
    assert "obj_000003.ply: cannot be written: No space left on device" in said


def test_problems_name_their_object(tmp_path, monkeypatch):
    library = Library(bop(tmp_path / "library"))
    library.add(block(tmp_path), Facts(name="block"))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    contacts = [
        {"point": [0.03, 0.01, 0.02], "normal": [1, 0, 0]},
        {"point": [-0.03, 0.01, 0.02], "normal": [-1, 0, 0]},
    ]
    vision = {
        "position": [0.004, 0, 0],
        "quaternion_xyzw": [0, 0, 0, 1],
        "sigma_position": 0.01,
        "sigma_rotation_deg": 5,
    }
    problem = {"contacts": contacts, "vision": vision}
    answers = corrected(
        {**problem, "object": {"name": "block"}},
        {**problem, "object": {"mesh": str(tmp_path / "block.off")}},
        {**problem, "object": {"name": "blok"}},
        {**problem, "object": {"name": "obj_000001"}},
        {**problem, "object": {"name": "block", "scale": 2}},
        expect=1,
    )
    for key in ("position", "quaternion_xyzw", "covariance"):
        assert json.dumps(answers[0][key]) == json.dumps(answers[1][key])
    assert (
        answers[2]["error"]
        == f"object.name: expected an object of {tmp_path}/library, got 'blok'; the nearest valid one is 'block'"
    )
    assert abs(answers[3]["position"][0]) < 1e-3
    assert answers[4]["error"] == "object.scale: expected beside mesh only, got it beside name"
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "nowhere"))
    (answer,) = corrected({**problem, "object": {"name": "block"}}, expect=1)
    assert answer["error"].startswith(f"object.name: {tmp_path}/nowhere: expected a library")


def test_workers_have_the_same_library(tmp_path, monkeypatch):
    Library(tmp_path / "library").add(block(tmp_path), Facts(name="block"))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    problem = {"object": {"name": "block"}, "contacts": [{"point": [0.03, 0.01, 0.02]}]}
    (tmp_path / "p.jsonl").write_text(json.dumps(problem | {"vision": {
        "position": [0, 0, 0], "quaternion_xyzw": [0, 0, 0, 1], "sigma_position": 0.01, "sigma_rotation_deg": 5}}) + "\n")  # fmt: skip
    out, _ = run("correct", "p.jsonl", "--workers", "1", cwd=tmp_path)
    again, _ = run("correct", "p.jsonl", "--workers", "2", cwd=tmp_path)
    assert json.loads(out)["position"] == json.loads(again)["position"]


def test_a_recordings_object_may_be_one_of_the_library(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    from handsight.rig.save import write
    from rig.rigs import full

    rig = full(tmp_path)
    write(rig, tmp_path / "rig.yaml")
    library = Library(tmp_path / "library")
    monkeypatch.setenv("HANDSIGHT_LIBRARY", library.place)
    with pytest.raises(
        InvalidInput, match=r"--object: expected a name of .*rig\.yaml or a mesh file, got 'mustard'"
    ):
        Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", "mustard")
    library.add(block(tmp_path), Facts(name="mustard"))
    for name in ("mustard", "bottle"):  # the rig's bottle is the library's mustard
        model = Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", name).model
        assert model.name == name
        assert model.diameter == library.entry("mustard").diameter
    with pytest.raises(InvalidInput, match="got 'mustrd'; the nearest valid one is 'mustard'"):
        Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", "mustrd")


@pytest.mark.parametrize(
    "environment",
    [{"PYTHONIOENCODING": "ascii"}, {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONCOERCECLOCALE": "0"}],
)
def test_a_terminal_of_ascii_gets_every_name(tmp_path, monkeypatch, environment):
    Library(tmp_path / "lab").add(block(tmp_path), Facts(name="Dose µ", licence="©"))
    for key, value in environment.items():
        monkeypatch.setenv(key, value)
    for command in (("list",), ("show", "1"), ("verify",)):
        out, _ = run("objects", *command, "--library", tmp_path / "lab")
        assert "verify" in command or "Dose" in out


def test_warnings_that_are_errors_end_a_command_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    mesh = block(tmp_path, (60, 90, 140))
    _, said = run("objects", "add", mesh, "--name", "a", "--library", tmp_path / "lab", expect=2)
    assert "block.off: largest extent 140 m: looks like millimetres" in said
    run("objects", "add", mesh, "--name", "a", "--library", tmp_path / "lab", "--scale", 0.001)
    assert "block" not in run("objects", "list", "--library", tmp_path / "lab")[0]


def test_a_mesh_in_millimetres_is_added_only_by_force(tmp_path):
    mesh, there = block(tmp_path, (60, 90, 140)), ("--name", "a", "--library", tmp_path / "lab")
    _, said = run("objects", "add", mesh, *there, expect=2)
    assert "expected an object for a hand, got one of largest extent 140 m: looks like millimetres" in said
    run("objects", "add", mesh, *there, "--force")
