"""An object added to a library is read back as the same object, and a folder of a BOP data set is a library."""

import json
import os
import re
import shutil

import numpy as np
import pytest
import trimesh

from handsight.errors import InvalidFile, InvalidInput, InvalidObject
from handsight.objects import (
    Facts,
    Library,
    ObjectModel,
    Shape,
    declared_symmetries,
    ply_bytes,
    read_shape,
)
from objects.libraries import block, bop, off_text
from objects.object_shapes import box_mesh, data_file, prism


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


def test_an_added_cloud_stays_a_cloud_and_keeps_its_normals(tmp_path, rng):
    points, normals = ObjectModel.sphere(0.04).sample(300)
    file = tmp_path / "ball.xyz"
    np.savetxt(file, np.hstack([points, normals]), fmt="%.17g")
    library = Library(tmp_path)
    library.add(file, Facts(name="ball"))
    kept = read_shape(library.file(library.entry("ball")))
    assert kept.faces is None
    np.testing.assert_allclose(1e-3 * kept.vertices, points, atol=1e-12)
    np.testing.assert_allclose(kept.normals, normals, atol=1e-12)


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
    shape = Shape(vertices, None, rng.normal(size=(40, 3))) if normals else Shape(vertices, faces)
    (tmp_path / "a.ply").write_bytes(ply_bytes(shape, scale))
    back = read_shape(tmp_path / "a.ply")
    np.testing.assert_array_equal(back.vertices, scale * vertices)
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
    with pytest.raises(InvalidFile, match=r"models/obj_000001\.ply: cannot be read: No such file"):
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
    with pytest.raises(
        InvalidFile, match=r"obj_000001\.ply: expected the SHA-256 \w{12}…, got \w{12}…: changed since"
    ):
        library.model("block")
    path.write_bytes(good[:-1])
    with pytest.raises(InvalidFile, match=rf"expected {len(good)} bytes, got {len(good) - 1}: changed since"):
        library.model("block")
    path.write_bytes(good)
    assert library.model("block").closed


def test_a_model_above_the_size_limit_is_refused_unread(tmp_path):
    library = Library(bop(tmp_path))
    os.truncate(tmp_path / "models/obj_000001.ply", 600_000_000)  # a hole, which takes no room
    with pytest.raises(
        InvalidFile, match=r"obj_000001\.ply: expected at most 500000000 bytes, got 600000000"
    ):
        library.model("1")


def test_the_message_for_an_unknown_name_suggests_the_nearest(tmp_path):
    library = Library(tmp_path)
    library.add(block(tmp_path), Facts(name="mustard"))
    with pytest.raises(
        InvalidInput,
        match=rf"^name: expected an object of {tmp_path}, got 'Mustrd'; the nearest valid one is 'mustard'$",
    ):
        library.entry("Mustrd")
    with pytest.raises(InvalidInput, match=r"; valid: mustard$"):
        library.entry("../../etc/passwd")
    with pytest.raises(
        InvalidFile, match=r"nowhere: expected a library, with models/models_info\.json, got none"
    ):
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
    with pytest.raises(InvalidInput, match=r"^name: expected"):
        Facts(name=name)


@pytest.mark.parametrize(
    ("facts", "message"),
    [
        ({"mass": 603.0}, r"mass: expected kilograms, got 603 \(grams\?\)"),
        ({"mass": -1.0}, "mass: expected a number above 0, got -1"),
        ({"mass": float("nan")}, "mass: expected a finite number, got nan"),
        ({"center_of_mass": (0.0, 0.0, 80.0)}, r"center_of_mass: expected metres within 5, .* \(millimetres\?"),
        ({"center_of_mass": (0.0, 0.0, 0.2)}, r"center_of_mass: expected metres from \[-0\.0\d+, .*\] to .*, where the object is, got"),
        ({"sigma_center_of_mass": 0.01}, "sigma_center_of_mass: expected beside center_of_mass only"),
        ({"licence": "x" * 501}, "licence: expected a text of up to 500 characters"),
    ],
)  # fmt: skip
def test_impossible_facts_are_refused(tmp_path, facts, message):
    with pytest.raises(InvalidInput, match=f"^{message}"):
        Library(tmp_path / "library").add(block(tmp_path), Facts(name="block", **facts))
    assert not (tmp_path / "library").exists()


def test_a_name_that_is_taken_is_refused(tmp_path):
    library = Library(tmp_path)
    library.add(block(tmp_path), Facts(name="block"))
    with pytest.raises(
        InvalidInput, match="^name: expected a new one, got 'block', which is that of object 1$"
    ):
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


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["w"], "expected find, an axis .*, got 'w'"),
        (["z/0"], "expected find, an axis"),
        (["z/2/3"], "expected find, an axis"),
        (["find", "z"], "expected find alone, got find z"),
        (["z"], "expected turns that leave the surface in place, got z, which is .* mm off"),
        (["x/3"], "expected turns that leave the surface in place, got x/3"),
    ],
)
def test_declared_symmetries_that_the_surface_does_not_have_are_refused(words, message):
    with pytest.raises(InvalidInput, match=f"^symmetry: {message}"):
        declared_symmetries(ObjectModel.box((0.06, 0.09, 0.14)), words)


def test_a_real_object_is_the_same_from_the_library(tmp_path):
    file = data_file("ycb_meshes/006_mustard_bottle.ply")
    library = Library(tmp_path)
    library.add(file, Facts(name="mustard"))
    model, expected = ObjectModel.from_library("mustard", tmp_path), ObjectModel.from_file(file)
    points = expected.sample(500)[0] + 0.003
    np.testing.assert_allclose(model.evaluate(points).distance, expected.evaluate(points).distance, atol=1e-6)


def test_the_library_is_the_one_that_the_environment_names(tmp_path, monkeypatch):
    Library(tmp_path / "named").add(block(tmp_path), Facts(name="block"))
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "named"))
    assert ObjectModel.from_library("block").name == "block"
    monkeypatch.delenv("HANDSIGHT_LIBRARY")
    monkeypatch.setenv("XDG_DATA_HOME", str(tmp_path / "data"))
    shutil.copytree(tmp_path / "named", tmp_path / "data/handsight/library")
    assert Library().entry("block").number == 1
    monkeypatch.setenv("XDG_DATA_HOME", "relative")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert Library().place == str(tmp_path / ".local/share/handsight/library")


def test_a_file_without_an_object_is_not_added(tmp_path):
    library = Library(tmp_path / "library")
    (tmp_path / "line.off").write_text("OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n")
    with pytest.raises(InvalidObject, match=r"^line\.off: "):
        library.add(tmp_path / "line.off", Facts(name="line"))
    with pytest.raises(InvalidInput, match="facts: expected Facts, got dict"):
        library.add(block(tmp_path), {"name": "x"})
    assert re.fullmatch(r"<Library .*/library>", repr(library))
