"""An object added to a library is read back as the same object, and a folder of a BOP data set is a library."""

import json
import os
import shutil

import numpy as np
import pytest
import trimesh

from handsight.errors import InvalidFile, InvalidInput
from handsight.objects import Facts, Library, ObjectModel, Shape, declared_symmetries, ply_bytes, read_shape
from objects.libraries import block, bop, off_text
from objects.object_shapes import box_mesh, prism
from testbed.refusals import refused


@pytest.mark.parametrize("scale", [1.0, 0.001, 0.0254])
@pytest.mark.parametrize("shape", [box_mesh((0.05, 0.06, 0.07)), prism(7, 0.03, 0.1)], ids=["box", "prism"])
def test_an_added_object_is_read_back_as_the_same_object(tmp_path, shape, scale, rng):
    vertices, faces = shape
    file = tmp_path / "thing.off"
    file.write_text(off_text((vertices + rng.normal(size=3) * 0.1) / scale, faces))
    facts = Facts(name="a thing", mass=0.5, licence="CC0", source="made here", sigma_center_of_mass=None)
    Library(tmp_path / "library").add(file, facts, scale=scale)
    library = Library(tmp_path / "library")
    model, expected = library.model("a thing"), ObjectModel.from_file(file, scale)
    np.testing.assert_allclose(model.vertices, expected.vertices, rtol=0, atol=1e-9)
    np.testing.assert_array_equal(model.faces, expected.faces)
    entry = library.entry("a thing")
    assert model.name == entry.name == "a thing"
    assert entry.diameter == pytest.approx(expected.diameter, abs=1e-9)
    np.testing.assert_allclose(entry.size, np.ptp(expected.bounds_object, axis=0), atol=1e-9)
    assert {key: getattr(entry.facts, key) for key in Facts.__struct_fields__} == {
        key: getattr(facts, key) for key in Facts.__struct_fields__
    }
    assert not list(library.wrong(library.entries()))


def test_a_ply_in_millimetres_is_kept_byte_for_byte(tmp_path):
    bop(tmp_path / "theirs")
    file = tmp_path / "theirs/models/obj_000001.ply"
    library = Library(tmp_path / "ours")
    entry = library.add(file, Facts(name="box"), scale=0.001)
    assert library.file(entry).read_bytes() == file.read_bytes()


@pytest.mark.parametrize("normals", [False, True])
@pytest.mark.parametrize("scale", [1.0, 1000.0, 0.3])
def test_a_written_ply_is_read_back_by_handsight_and_by_trimesh(tmp_path, rng, normals, scale):
    vertices, faces = rng.normal(size=(40, 3)), rng.integers(0, 40, (25, 3))
    outward = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    shape = Shape(outward, None, 2 * outward) if normals else Shape(vertices, faces)
    (tmp_path / "a.ply").write_bytes(ply_bytes(shape, scale))
    back = read_shape(tmp_path / "a.ply")
    np.testing.assert_array_equal(back.vertices, scale * shape.vertices)
    if normals:
        np.testing.assert_array_equal(back.normals, shape.normals)
        return
    np.testing.assert_array_equal(back.faces, faces)
    theirs = trimesh.load(tmp_path / "a.ply", process=False)
    np.testing.assert_allclose(theirs.vertices, scale * vertices, rtol=1e-15)
    np.testing.assert_array_equal(theirs.faces, faces)


def test_a_folder_of_a_bop_data_set_is_a_library(tmp_path):
    for place in (bop(tmp_path), tmp_path / "models"):
        library = Library(place)
        assert [entry.name for entry in library.entries()] == ["obj_000001", "obj_000005"]
        for name in ("obj_000005", "5"):
            model = library.model(name)
            np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), [0.05, 0.04, 0.03])
            assert len(model.symmetries.rotations) == 2
        assert not list(library.wrong(library.entries()))


def test_an_add_keeps_the_documents_and_files_of_others(tmp_path):
    before = json.loads((bop(tmp_path) / "models/models_info.json").read_text())
    (tmp_path / "models/obj_000009.ply").write_text("not listed, and not ours")
    library = Library(tmp_path)
    entry = library.add(block(tmp_path), Facts(name="block"))
    assert entry.number == 10
    after = json.loads((tmp_path / "models/models_info.json").read_text())
    assert after.pop("10")["size_z"] == pytest.approx(140)
    assert after == before
    assert (tmp_path / "models/obj_000009.ply").read_text() == "not listed, and not ours"
    assert [each.name for each in library.entries()] == ["obj_000001", "obj_000005", "block"]
    assert library.entry("block") is not None
    assert library.entry("obj_000010").name == "block"


def test_a_missing_model_of_a_bop_folder_is_named_and_the_others_are_read(tmp_path):
    library = Library(bop(tmp_path))
    (tmp_path / "models/obj_000001.ply").unlink()
    with refused(InvalidFile, "obj_000001.ply"):
        library.model("1")
    assert library.model("5").closed
    (message,) = library.wrong(library.entries())
    assert "obj_000001.ply: cannot be read: No such file or directory" in message


def test_a_model_in_another_unit_than_its_documents_is_reported(tmp_path):
    library = Library(bop(tmp_path, diameter=0.177))
    (message,) = library.wrong(library.entries())
    assert "obj_000001.ply: expected the diameter 0.177 mm, got 176.9: another unit?" in message


def test_a_model_that_was_changed_or_cut_is_refused(tmp_path):
    library = Library(tmp_path)
    entry = library.add(block(tmp_path), Facts(name="block"))
    path = library.file(entry)
    good = path.read_bytes()
    path.write_bytes(good[:-1] + bytes([good[-1] ^ 1]))
    with refused(InvalidFile, "obj_000001.ply"):
        library.model("block")
    path.write_bytes(good[:-1])
    with refused(InvalidFile, "obj_000001.ply"):
        library.model("block")
    path.write_bytes(good)
    assert library.model("block").closed


def test_a_model_above_the_size_limit_is_refused_unread(tmp_path):
    library = Library(bop(tmp_path))
    os.truncate(tmp_path / "models/obj_000001.ply", 600_000_000)  # a hole, which takes no room
    with refused(InvalidFile, "obj_000001.ply"):
        library.model("1")


def test_the_message_for_an_unknown_name_suggests_the_nearest(tmp_path):
    library = Library(tmp_path)
    library.add(block(tmp_path), Facts(name="mustard"))
    with refused(InvalidInput, "name"):
        library.entry("Mustrd")
    with refused(InvalidInput, "name"):
        library.entry("../../etc/passwd")
    with refused(InvalidFile, "nowhere"):
        Library(tmp_path / "nowhere").entry("mustard")


@pytest.mark.parametrize(
    "name",
    [
        "",
        " a",
        "a ",
        "../a",
        "a/b",
        "a\\b",
        ".a",
        "-a",
        "a\n",
        "\x1b[2J",
        "a\0",
        "7",
        "obj_000001",
        "x" * 101,
        None,
        3,
    ],
)
def test_a_name_that_harms_a_path_or_a_terminal_is_refused(name):
    with refused(InvalidInput, "name"):
        Facts(name=name)


@pytest.mark.parametrize(
    ("facts", "field"),
    [
        ({"mass": 603.0}, 'mass'),
        ({"mass": -1.0}, 'mass'),
        ({"mass": float("nan")}, 'mass'),
        ({"center_of_mass": (0.0, 0.0, 80.0)}, 'center_of_mass'),
        ({"center_of_mass": (0.0, 0.0, 0.2)}, 'center_of_mass'),
        ({"sigma_center_of_mass": 0.01}, 'sigma_center_of_mass'),
        ({"licence": "x" * 501}, 'licence'),
    ],
)  # fmt: skip
def test_impossible_facts_are_refused(tmp_path, facts, field):
    with refused(InvalidInput, field):
        Library(tmp_path / "library").add(block(tmp_path), Facts(name="block", **facts))
    assert not (tmp_path / "library").exists()


def test_a_name_that_is_taken_is_refused(tmp_path):
    library = Library(tmp_path)
    library.add(block(tmp_path), Facts(name="block"))
    with refused(InvalidInput, "name"):
        library.add(block(tmp_path), Facts(name="block"))
    assert len(library.entries()) == 1


@pytest.mark.parametrize(
    ("words", "axes", "rotations"),
    [
        ([], 0, 1),
        (["z"], 1, 1),
        (["z", "x/2"], 1, 2),
        (["z/3"], 0, 3),
        (["z/3", "x/2"], 0, 6),
        (["find"], 0, 6),
    ],
)
def test_symmetries_are_declared_in_words(words, axes, rotations):
    # A prism of 24 sides is round within the tolerance.
    sides = 24 if "z" in words else 3
    vertices, faces = prism(sides, 0.04, 0.1)
    model = ObjectModel.from_mesh(np.add(vertices, [0.01, -0.02, 0.03]), faces)
    found = declared_symmetries(model, words)
    assert (len(found.axes), len(found.rotations)) == (axes, rotations)
    for point, direction in found.axes:
        np.testing.assert_allclose(np.cross(point - [0.01, -0.02, 0.03], direction), 0, atol=1e-9)


@pytest.mark.parametrize("words", [["w"], ["z/0"], ["z/2/3"], ["find", "z"], ["z"], ["x/3"]])
def test_declared_symmetries_that_the_surface_does_not_have_are_refused(words):
    with refused(InvalidInput, "symmetry"):
        declared_symmetries(ObjectModel.box((0.06, 0.09, 0.14)), words)


def test_the_library_is_the_one_that_the_environment_names(tmp_path, monkeypatch):
    Library(tmp_path / "named").add(block(tmp_path), Facts(name="block"))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "named"))
    assert Library().model("block").name == "block"
    monkeypatch.delenv("HANDSIGHT_LIBRARY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    shutil.copytree(tmp_path / "named", tmp_path / "data/handsight/library")
    assert Library().entry("block").number == 1
    monkeypatch.setenv("XDG_DATA_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert Library().place == str(tmp_path / ".local/share/handsight/library")
