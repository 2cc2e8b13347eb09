import contextlib
import dataclasses
import io
import os
import subprocess
import sys

import msgspec
import numpy as np
import pytest
import trimesh

from handsight.cache_folder import write_entry
from handsight.objects import FieldError, Geometry, GridField, ObjectModel, ObjectWarning, cache
from handsight.objects import model as object_models
from objects.object_shapes import BOX_FACES, box_mesh, triangles


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "fields"))
    return tmp_path / "fields"


def box():
    return ObjectModel.from_mesh(*box_mesh((0.06, 0.09, 0.05)))


def same(a, b):
    """The geometries of two objects are equal to the last bit."""
    for part in dataclasses.fields(Geometry):
        one, other = getattr(a, part.name), getattr(b, part.name)
        if isinstance(one, np.ndarray):
            np.testing.assert_array_equal(one, other)
            assert (one.dtype, other.flags.writeable) == (other.dtype, False)
        elif isinstance(one, GridField | FieldError):
            np.testing.assert_array_equal(one.values, other.values)
            np.testing.assert_array_equal([*one.origin, one.cell], [*other.origin, other.cell])
        elif part.name != "surface":
            assert one == other, part.name
    for one, other in zip(a.sample(50, 3), b.sample(50, 3), strict=True):
        np.testing.assert_array_equal(one, other)


def test_the_same_mesh_is_built_once(folder):
    first = box()
    (file,) = folder.iterdir()
    written = file.stat().st_mtime_ns
    same(box(), first)
    assert [each.stat().st_mtime_ns for each in folder.iterdir()] == [written]
    ObjectModel.from_mesh(*box_mesh((0.06, 0.09, 0.051)))
    assert len(list(folder.iterdir())) == 2


def test_a_damaged_file_is_built_again(folder):
    """What counts as damaged is a law of what is kept in a cache."""
    first = box()
    (file,) = folder.iterdir()
    good = file.read_bytes()
    for damaged in (
        b"",
        good[: len(good) // 2],
        good.replace(b"(256, 3)", b"(255, 3)"),
    ):  # that could be read
        file.write_bytes(damaged)
        same(box(), first)
        assert file.read_bytes() == good


def test_a_file_of_another_content_or_another_object_is_built_again(folder):
    ObjectModel.from_mesh(*box_mesh((0.06, 0.09, 0.051)))
    (other,) = folder.iterdir()
    first = box()
    (file,) = set(folder.iterdir()) - {other}
    with file.open("wb") as out:
        np.savez(out, coarse=np.zeros(3))
    same(box(), first)
    file.write_bytes(other.read_bytes())
    same(box(), first)


def test_pickled_content_is_never_loaded(folder):
    box()
    (file,) = folder.iterdir()

    class Trap:
        def __reduce__(self):
            return sys.exit, ("a pickle was loaded",)

    trap = io.BytesIO()
    np.save(trap, np.array([Trap()], dtype=object))
    content = msgspec.msgpack.encode({"area": msgspec.msgpack.Ext(0, trap.getvalue())})
    name = file.stem.removeprefix("field-")
    write_entry(file, name, content)
    box()


def test_a_folder_that_cannot_be_written_warns_once(folder, monkeypatch):
    def full(*_):
        raise OSError("No space left on device")

    monkeypatch.setattr(cache, "write_entry", full)
    with pytest.warns(ObjectWarning):
        box()
    box()  # warnings are errors here


def test_the_newest_files_are_kept(folder, monkeypatch):
    monkeypatch.setattr(cache, "KEPT", 3)
    folder.mkdir()
    (folder / "mine.npz").write_text("the user's own")
    box()
    geometry = object_models._of_mesh(triangles(*box_mesh((0.06, 0.09, 0.05))))
    for file in folder.glob("field-*"):
        os.utime(file, (0, 0))
    for k in range(1, 6):
        cache.remembered(f"{k}" * 8, lambda: geometry)
        os.utime(folder / f"field-{f'{k}' * 8}.msgpack", (k, k))
    assert sorted(f.name for f in folder.iterdir()) == [
        "field-33333333.msgpack", "field-44444444.msgpack", "field-55555555.msgpack", "mine.npz",
    ]  # fmt: skip


PROGRAM = """
import sys
from handsight.objects import ObjectModel
import numpy as np
corners = np.array([(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * [0.03, 0.045, 0.025]
faces = np.array({faces})
print("ready", flush=True)
sys.stdin.readline()
print(float(ObjectModel.from_mesh(corners, faces).fine.values.astype(float).sum()))
"""


def test_two_processes_may_build_the_same_object_at_once(folder):
    program = PROGRAM.format(faces=[list(face) for face in BOX_FACES])
    environment = {**os.environ, "HANDSIGHT_CACHE": str(folder)}
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True, "env": environment}
    with contextlib.ExitStack() as stack:
        workers = [
            stack.enter_context(subprocess.Popen([sys.executable, "-c", program], **pipes)) for _ in range(2)
        ]
        try:
            assert [worker.stdout.readline() for worker in workers] == ["ready\n"] * 2
            for worker in workers:
                worker.stdin.write("go\n")
                worker.stdin.flush()
            found = [float(worker.communicate(timeout=300)[0]) for worker in workers]
        finally:
            for worker in workers:
                worker.kill()
    assert [worker.returncode for worker in workers] == [0, 0]
    assert found[0] == found[1] == float(box().fine.values.astype(float).sum())
    assert [f.suffix for f in folder.iterdir()] == [".msgpack"]


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "thing.ply"
    trimesh.Trimesh(*box_mesh((0.06, 0.09, 0.05)), process=False).export(path)
    return path


def test_another_scale_or_content_is_another_object(folder, file):
    whole, half = ObjectModel.from_file(file), ObjectModel.from_file(file, scale=0.5)
    assert whole.diameter == pytest.approx(2 * half.diameter)
    trimesh.Trimesh(*box_mesh((0.06, 0.09, 0.08)), process=False).export(file)
    assert ObjectModel.from_file(file).bounds_object[1, 2] == pytest.approx(0.04)


def test_a_file_in_the_cache_needs_neither_trimesh_nor_scipy(folder, file):
    ObjectModel.from_file(file)
    program = f"""
import sys
import handsight as hs
hs.ObjectModel.from_file({str(file)!r})
loaded = {{"trimesh", "scipy", "numba"}} & set(sys.modules)
assert not loaded, loaded
"""
    subprocess.run([sys.executable, "-c", program], check=True, timeout=60)
