"""An output is complete, or it is what it was before: whatever ends a command before its first answer."""

import json
import signal
import subprocess

import pytest
import trimesh

from batch.box_problem import BOX
from cli.commands import begun, called, waited_for
from handsight.files import atomic_file

BEFORE = "as it was"
NEVER = {
    "correct": ("correct", "-", "-o", "out.jsonl"),
    "contact": ("contact", "-", "--fingertip", "sphere:8mm", "-o", "out.csv"),
}
"""Commands that wait for a first line which never comes."""


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("name", NEVER)
def test_a_signal_before_the_first_answer_leaves_an_earlier_file_and_nothing_beside_it(tmp_path, name, sent):
    output = tmp_path / NEVER[name][-1]
    output.write_text(BEFORE)
    command = begun(NEVER[name], stdin=subprocess.PIPE, stdout=subprocess.PIPE, cwd=tmp_path)
    waited_for(lambda: len(list(tmp_path.iterdir())) == 2)  # what it will write grows under another name
    command.send_signal(sent)
    assert command.wait(timeout=60) == 130
    _, said = command.communicate()
    assert b"Traceback" not in said
    assert [path.name for path in tmp_path.iterdir()] == [output.name]
    assert output.read_text() == BEFORE


@pytest.fixture
def recorded(grasp, tmp_path):
    """A recording of a grasp with its rig, and what each command writes, of an earlier run."""
    from cli.tracks import observations
    from cli.tracks import recorded as record
    from handsight.rig.save import write as write_rig

    rig, _ = grasp
    record(tmp_path / "can.mcap", observations(grasp)[:5], rig)
    write_rig(rig, tmp_path / "can.rig.yaml")
    (tmp_path / "can-track").mkdir()
    for name in ("can-track/track.csv", "can-track/summary.json", "new.mcap", "new.rig.yaml", "model.ply"):
        (tmp_path / name).write_text(BEFORE)
    return tmp_path


def contents(folder):
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


@pytest.mark.parametrize(
    ("owner", "arguments"),
    [
        ("handsight.recording.Recording.observations", ("track", "can.mcap", "--object", "can")),
        ("handsight.simulation.simulate", ("simulate", "can", "-o", "new.mcap")),
    ],
    ids=["track", "simulate"],
)
def test_ctrl_c_before_the_first_observation_changes_no_file(recorded, monkeypatch, owner, arguments):
    def interrupted(*_):
        raise KeyboardInterrupt

    before = contents(recorded)
    monkeypatch.setattr(owner, interrupted)
    assert called(monkeypatch, recorded, *arguments) == 130
    assert contents(recorded) == before


def test_a_picture_that_fails_leaves_an_earlier_one(tmp_path, monkeypatch):
    figure = pytest.importorskip("matplotlib.figure")

    def fails(self, file, **_):
        file.write(b"some of it")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure.Figure, "savefig", fails)
    (tmp_path / "one.json").write_text(json.dumps(BOX))
    (tmp_path / "a.png").write_text(BEFORE)
    assert called(monkeypatch, tmp_path, "correct", "one.json", "-o", "a.jsonl", "--plot", "a.png") == 130
    assert (tmp_path / "a.png").read_text() == BEFORE
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.jsonl", "a.png", "one.json"]


def test_a_link_stays_a_link_to_the_new_content(tmp_path):
    (tmp_path / "there").write_text(BEFORE)
    (tmp_path / "link").symlink_to("there")
    with atomic_file(tmp_path / "link") as file:
        file.write(b"new")
    assert (tmp_path / "link").is_symlink()
    assert (tmp_path / "there").read_bytes() == b"new"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["link", "there"]


def test_the_linked_documents_of_a_library_stay_linked(tmp_path, monkeypatch):
    trimesh.creation.box((0.06, 0.09, 0.14)).export(tmp_path / "box.stl")
    add = ("objects", "add", "box.stl", "--library", "things", "--name")
    assert called(monkeypatch, tmp_path, *add, "tea") == 0
    info = tmp_path / "things/models/models_info.json"
    info.rename(tmp_path / "elsewhere.json")
    info.symlink_to(tmp_path / "elsewhere.json")
    assert called(monkeypatch, tmp_path, *add, "other") == 0
    assert info.is_symlink()
    assert set(json.loads((tmp_path / "elsewhere.json").read_text())) == {"1", "2"}


@pytest.mark.parametrize("kind", ["others can write", "a file"])
def test_kernels_are_not_compiled_for_a_folder_that_cannot_keep_them(tmp_path, monkeypatch, kind):
    into = tmp_path / "into"
    if kind == "a file":
        into.write_text(BEFORE)
    else:
        into.mkdir()
        into.chmod(0o777)
    assert called(monkeypatch, tmp_path, "warmup", "--into", into) == 74
