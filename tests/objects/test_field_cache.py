import multiprocessing
import os
import sys

import numpy as np
import pytest

from handsight.cache_folder import cache_folder
from handsight.objects import ObjectModel, ObjectWarning, cache
from objects.object_shapes import box_mesh


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "fields"))
    return tmp_path / "fields"


@pytest.fixture
def counted(monkeypatch):
    """How often fields were built."""
    from handsight.objects import sources

    calls = []
    build = sources.mesh_fields
    monkeypatch.setattr(sources, "mesh_fields", lambda *a: calls.append(1) or build(*a))
    return calls


def box():
    return ObjectModel.from_mesh(*box_mesh((0.06, 0.09, 0.05)))


def same(a, b):
    np.testing.assert_array_equal(a.coarse.values, b.coarse.values)
    np.testing.assert_array_equal(a.fine.values, b.fine.values)
    assert (a.closed, a.remarks, a.sigma_point) == (b.closed, b.remarks, b.sigma_point)


def test_the_same_geometry_is_built_once(folder, counted):
    first, second = box(), box()
    same(first, second)
    assert len(counted) == 1
    assert len(list(folder.iterdir())) == 1
    ObjectModel.from_mesh(*box_mesh((0.06, 0.09, 0.051)))
    assert len(counted) == 2


@pytest.mark.parametrize("damage", ["empty", "cut", "text", "flipped", "array"])
def test_a_damaged_file_is_built_again(folder, counted, damage):
    first = box()
    (file,) = folder.iterdir()
    whole = file.read_bytes()
    middle = len(whole) // 2
    flipped = whole[:middle] + bytes([whole[middle] ^ 255]) + whole[middle + 1 :]
    if damage == "array":
        with file.open("wb") as out:
            np.save(out, np.zeros(3))
    else:
        file.write_bytes({"empty": b"", "cut": whole[:middle], "text": b"no", "flipped": flipped}[damage])
    same(box(), first)
    assert len(counted) == 2
    assert file.read_bytes() == whole


def test_a_file_of_another_content_is_built_again(folder, counted):
    box()
    (file,) = folder.iterdir()
    np.savez(file, coarse=np.zeros(3))
    box()
    assert len(counted) == 2


def test_pickled_content_is_never_loaded(folder, counted):
    box()
    (file,) = folder.iterdir()

    class Trap:
        def __reduce__(self):
            return sys.exit, ("a pickle was loaded",)

    np.savez(
        file,
        **dict.fromkeys(
            ("coarse", "coarse_grid", "fine", "fine_grid", "closed", "remarks"),
            np.array([Trap()], dtype=object),
        ),
    )
    box()
    assert len(counted) == 2


def test_a_folder_that_cannot_be_written_warns_once(tmp_path, monkeypatch, counted):
    (tmp_path / "file").write_text("in the way")
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "file" / "fields"))
    with pytest.warns(ObjectWarning, match="distance fields cannot be cached there"):
        box()
    box()  # warnings are errors here
    assert len(counted) == 2


def test_the_newest_files_are_kept(folder, monkeypatch):
    monkeypatch.setattr(cache, "KEPT", 3)
    folder.mkdir()
    (folder / "mine.npz").write_text("the user's own")
    for k in range(6):
        name = f"{k}" * 8
        cache.remembered(name, {"a"}, lambda k=k: {"a": np.full(2, k)})
        os.utime(folder / f"field-{name}.npz", (k, k))
    assert sorted(f.name for f in folder.iterdir()) == [
        "field-33333333.npz", "field-44444444.npz", "field-55555555.npz", "mine.npz",
    ]  # fmt: skip


def test_where_the_files_go(monkeypatch, tmp_path):
    monkeypatch.setenv("HANDSIGHT_CACHE", str(tmp_path / "a"))
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "b"))
    assert cache_folder() == tmp_path / "a"
    monkeypatch.delenv("HANDSIGHT_CACHE")
    assert cache_folder() == tmp_path / "b" / "handsight"
    monkeypatch.delenv("XDG_CACHE_HOME")
    monkeypatch.setenv("HOME", str(tmp_path))
    assert cache_folder() == tmp_path / ".cache" / "handsight"


def build_in(folder, gate, answers):
    os.environ["HANDSIGHT_CACHE"] = folder
    gate.wait()
    answers.put(float(box().fine.values.astype(float).sum()))


def test_two_processes_may_build_the_same_object_at_once(folder):
    context = multiprocessing.get_context("spawn")
    gate, answers = context.Barrier(2), context.Queue()
    workers = [context.Process(target=build_in, args=(str(folder), gate, answers)) for _ in range(2)]
    for worker in workers:
        worker.start()
    found = [answers.get(timeout=120) for _ in workers]
    for worker in workers:
        worker.join(timeout=60)
        assert worker.exitcode == 0
    assert found[0] == found[1] == float(box().fine.values.astype(float).sum())
    assert [f.suffix for f in folder.iterdir()] == [".npz"]
