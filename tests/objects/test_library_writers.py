"""Several writers lose nothing, and an add that is interrupted in any way leaves the library as it was."""

import errno
import json
import os
import subprocess
import sys
import threading

import pytest

from handsight.errors import NotWritten
from handsight.objects import Facts, Library
from handsight.objects.library import folder as folders
from handsight.objects.library.folder import Folder, new_object
from objects.libraries import block, bop

RENAMES = 3
"""The renames of an add: of the model, handsight.json and models_info.json."""
ADD = """
import os, signal, sys, time
from handsight.errors import NotWritten
from handsight.objects import Facts, Library
place, file, prefix, count, dies_at = sys.argv[1:]
renames, replace = [], os.replace
def counted(a, b):
    if "library" in str(b):
        renames.append(b)
        if len(renames) == int(dies_at):
            os.kill(os.getpid(), signal.SIGKILL)
    replace(a, b)
os.replace = counted
for k in range(int(count)):
    while True:
        try:
            Library(place).add(file, Facts(name=f"{prefix}{k}"))
            break
        except NotWritten:  # another process is adding
            time.sleep(0.01)
"""


def adding(place, file, prefix, count=1, dies_at=0):
    """A process that adds to a library."""
    arguments = [sys.executable, "-c", ADD, *map(str, (place, file, prefix, count, dies_at))]
    return subprocess.Popen(arguments, stderr=subprocess.PIPE)


def names(library):
    return sorted(entry.name for entry in library.entries())


def test_writers_at_the_same_time_lose_nothing(tmp_path):
    library, file, count = Library(tmp_path / "library"), block(tmp_path), 6
    library.add(file, Facts(name="first"))
    writers = {prefix: adding(library.place, file, prefix, count) for prefix in ("one", "two", "three")}
    for writer in writers.values():
        _, errors = writer.communicate(timeout=300)
        assert writer.returncode == 0, errors.decode()
    assert names(library) == sorted(["first", *(f"{prefix}{k}" for prefix in writers for k in range(count))])
    assert [entry.number for entry in library.entries()] == list(range(1, 2 + 3 * count))
    assert not list(library.wrong(library.entries()))


def test_a_reader_finds_each_object_with_all_its_facts_while_another_adds(tmp_path):
    folder, library = Folder(tmp_path / "library"), Library(tmp_path / "library")
    facts, info, ply = new_object(block(tmp_path), Facts(name="block", mass=0.5), 1.0, None, False)
    folder.add(facts, info, ply)

    def write():
        for k in range(60):
            folder.add(facts | {"name": f"block {k}"}, info, ply)

    writer = threading.Thread(target=write)
    writer.start()
    reads, known = 0, 0
    while writer.is_alive():
        entries = library.entries()
        assert all(entry.facts is not None and entry.facts.mass == 0.5 for entry in entries)
        assert len(entries) >= known
        for entry in entries[known:]:
            assert library.file(entry).exists()
        reads, known = reads + 1, len(entries)
    writer.join()
    assert reads > 10
    assert len(library.entries()) == 61


@pytest.mark.parametrize("there", [False, True], ids=["new", "of others"])
@pytest.mark.parametrize("dies_at", range(1, RENAMES + 1))
def test_an_add_that_is_killed_before_its_end_is_invisible(tmp_path, dies_at, there):
    library, file = Library(tmp_path / "library"), block(tmp_path)
    if there:
        bop(tmp_path / "library")
    before = names(library) if there else []
    killed = adding(library.place, file, "killed", dies_at=dies_at)
    killed.communicate(timeout=300)
    assert killed.returncode == -9
    if there:
        assert names(library) == before
        assert not list(library.wrong(library.entries()))
    # Its lock ended with it, and the files that it left do no harm.
    entry = library.add(file, Facts(name="killed0", mass=0.1))
    assert entry.facts.mass == 0.1
    assert names(library) == sorted([*before, "killed0"])
    assert not list(library.wrong(library.entries()))
    # Nor may its facts become those of another object that later gets the same number.
    documents = [
        json.loads((tmp_path / f"library/models/{name}.json").read_text())
        for name in ("handsight", "models_info")
    ]
    assert documents[0]["objects"].keys() <= documents[1].keys()


@pytest.mark.parametrize("fails_at", range(1, RENAMES + 1))
def test_a_full_disk_is_reported_and_leaves_the_library_as_it_was(tmp_path, monkeypatch, fails_at):
    library, file = Library(tmp_path / "library"), block(tmp_path)
    library.add(file, Facts(name="first"))
    documents = ["models_info.json", "handsight.json"]
    before = [(tmp_path / "library/models" / name).read_bytes() for name in documents]
    calls, fsync = [], os.fsync

    def full(number):
        calls.append(number)
        if len(calls) == fails_at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        fsync(number)

    monkeypatch.setattr(folders.os, "fsync", full)
    with pytest.raises(NotWritten):
        library.add(file, Facts(name="second"))
    monkeypatch.undo()
    assert names(library) == ["first"]
    assert (tmp_path / "library/models/models_info.json").read_bytes() == before[0]
    assert not list((tmp_path / "library/models").glob(".*.part"))
    assert library.add(file, Facts(name="second")).name == "second"


def test_an_add_while_another_adds_is_refused_at_once(tmp_path):
    library, file = Library(tmp_path), block(tmp_path)
    with folders.locked(tmp_path / "models"), pytest.raises(NotWritten):
        library.add(file, Facts(name="block"))
    assert library.add(file, Facts(name="block")).number == 1


@pytest.mark.parametrize("make", [os.mkfifo, os.mkdir, lambda path: path.symlink_to("elsewhere")])
def test_a_lock_that_is_no_file_is_refused(tmp_path, make):
    (tmp_path / "models").mkdir()
    make(tmp_path / "models/.handsight.lock")
    with pytest.raises(NotWritten):
        Library(tmp_path).add(block(tmp_path), Facts(name="block"))
