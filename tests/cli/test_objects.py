"""`handsight objects`, and objects by name in other commands, as a user runs them."""

import json

import numpy as np
import pytest

from cli.commands import corrected, run
from handsight.cli.options import Run
from handsight.errors import InvalidInput
from handsight.objects import Facts, Library
from objects.libraries import block, bop, off_text, served
from objects.object_shapes import box_mesh, divided, prism
from testbed.refusals import refused

ADDED = ("--mass", "0.25", "--center-of-mass", "-0.01", "0", "0.02", "--sigma-center-of-mass", "0.005")
SAID = ("--licence", "CC BY 4.0 \x1b[2J")


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
    assert rows[1].split() == ["block", "none", "CC", "BY", "4.0", "\\x1b[2J", "1", "176.9", "250"]
    assert rows[2].split()[0] == "can"
    out, _ = asked("objects", "show", "block")
    shown = dict(line.split("  ", 1) for line in out.splitlines())
    shown = {key: value.strip() for key, value in shown.items()}
    assert shown["size"] == "60.0 x 90.0 x 140.0 mm"
    assert shown["centre of mass"] == "[-10.0, 0.0, 20.0] mm ± 5.0 mm per axis"
    assert shown["licence"] == "CC BY 4.0 \\x1b[2J"
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


def test_a_recordings_object_may_be_one_of_the_library(tmp_path, monkeypatch):
    pytest.importorskip("mujoco")
    from handsight.rig.save import write
    from rig.rigs import full

    rig = full(tmp_path)
    write(rig, tmp_path / "rig.yaml")
    library = Library(tmp_path / "library")
    monkeypatch.setenv("HANDSIGHT_LIBRARY", library.place)
    with refused(InvalidInput, "--object"):
        Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", "mustard")
    library.add(block(tmp_path), Facts(name="mustard"))
    for name in ("mustard", "bottle"):  # the rig's bottle is the library's mustard
        model = Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", name).model
        assert model.name == name
        assert model.diameter == library.entry("mustard").diameter
    with refused(InvalidInput, "--object"):
        Run.of(tmp_path / "a.mcap", tmp_path / "rig.yaml", "mustrd")


def test_warnings_that_are_errors_end_a_command_in_a_sentence(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONWARNINGS", "error")
    mesh = block(tmp_path, (60, 90, 140))
    _, said = run("objects", "add", mesh, "--name", "a", "--library", tmp_path / "lab", expect=2)
    assert "block.off: largest extent 140 m: looks like millimetres" in said
    run("objects", "add", mesh, "--name", "a", "--library", tmp_path / "lab", "--scale", 0.001)
    assert "block" not in run("objects", "list", "--library", tmp_path / "lab")[0]


def test_a_mesh_in_millimetres_is_not_added(tmp_path):
    mesh, there = block(tmp_path, (60, 90, 140)), ("--name", "a", "--library", tmp_path / "lab")
    _, said = run("objects", "add", mesh, *there, expect=2)
    assert "expected an object for a hand, got one of largest extent 140 m: looks like millimetres" in said


def test_a_scale_is_measured_and_its_sigma_kept(tmp_path, monkeypatch, asked):
    """Touches of a ball, in a frame of their own: a contact a line."""
    vertices, faces = box_mesh((0.5, 0.5, 0.5))
    vertices, faces = divided(vertices, faces, 3)
    vertices /= np.linalg.norm(vertices, axis=1)[:, None]
    (tmp_path / "ball.off").write_text(off_text(vertices, faces))
    ways = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, 0, 1], [0, -0.6, 0.8], [0.6, 0, -0.8]])
    lines = [{"point": list(0.04 * way + [0.1, 0, 0.2]), "normal": list(way)} for way in ways]
    (tmp_path / "touches.jsonl").write_text("\n".join(map(json.dumps, lines)))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    _, said = asked("objects", "add", "ball.off", "--name", "ball", "--scale-from", "touches.jsonl")
    assert "1 unit of ball.off is 0.0" in said
    (entry,) = Library(tmp_path / "library").entries()
    assert abs(entry.diameter - 0.08) < 3 * entry.facts.sigma_scale * 0.08
    _, said = asked("objects", "add", "ball.off", "--name", "b", "--scale-from", "depth.png", expect=2)
    assert "--mask" in said


def test_a_shape_in_map_coordinates_is_recentred_and_the_way_back_is_kept(tmp_path, monkeypatch, asked):
    vertices, faces = box_mesh()
    place = np.array([412_000.25, 5_648_000.5, 41.0])
    (tmp_path / "far.off").write_text(off_text(vertices + place, faces))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "library"))
    asked("objects", "add", "far.off", "--name", "far", expect=2)
    _, said = asked("objects", "add", "far.off", "--name", "far", "--recentre")
    assert "5648000.5000" in said
    (entry,) = Library(tmp_path / "library").entries()
    np.testing.assert_allclose(entry.facts.origin_file, place, atol=1e-3)
    near, _ = Library(tmp_path / "library").model("far").bounds_object
    np.testing.assert_allclose(near, vertices.min(axis=0), atol=1e-3)
