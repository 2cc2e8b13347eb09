"""`handsight view`: the page of a recording, as a user starts and ends it."""

import re
import shutil
import signal
import subprocess
import sys
import urllib.request
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

import handsight
from cli.commands import INTERRUPTIBLE, called
from handsight.recording import TrackRow, write_track_mcap

pytest.importorskip("mujoco")
pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")

DATA = Path(handsight.__file__).parent / "data"


@pytest.fixture
def folder(tmp_path):
    for name in ("can.mcap", "can.rig.yaml"):
        shutil.copy(DATA / name, tmp_path / name)
    return tmp_path


@pytest.mark.slow
def test_view_serves_a_page_where_it_says_and_ends_at_ctrl_c(folder):
    pytest.importorskip("viser", reason="the page needs handsight[view]")
    process = subprocess.Popen(
        [*INTERRUPTIBLE, "view", "can.mcap"],
        cwd=folder,
        stderr=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    said = process.stderr.readline()
    address = re.match(r"look at (http://127\.0\.0\.1:\d+/\?token=[\w-]+)[ ;]", said)[1]
    with urllib.request.urlopen(address, timeout=60) as page:
        assert b"<html" in page.read(4096)
    process.send_signal(signal.SIGINT)  # while it tracks
    assert process.communicate(timeout=60) == ("", "")
    assert process.returncode == 0


def test_without_viser_one_sentence_says_what_to_install(folder, monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert called(monkeypatch, folder, "view", "can.mcap") == 2
    assert capsys.readouterr().err == "handsight: the viewer needs viser: pip install 'handsight[view]'\n"


@pytest.mark.skipif(find_spec("viser") is None, reason="the page needs handsight[view]")
@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("away.mcap",), "--rig: expected a rig file, got nothing, and there is neither away.rig.yaml nor rig.yaml beside away.mcap"),
        (("can.mcap", "--object", "cna"), "--object: expected a name of can.rig.yaml or a mesh file, got 'cna'; the nearest valid one is 'can'"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_one_sentence(folder, monkeypatch, capsys, arguments, said):
    assert called(monkeypatch, folder, "view", *arguments) == 2
    assert capsys.readouterr().err.startswith(f"handsight: {said}")


@pytest.mark.skipif(find_spec("viser") is None, reason="the page needs handsight[view]")
def test_view_refuses_a_track_in_place_of_the_recording(folder, monkeypatch, capsys):
    write_track_mcap(folder / "track.mcap", [TrackRow(1.0, np.eye(4), np.eye(6), "tracking", "", np.eye(6))])
    assert called(monkeypatch, folder, "view", "track.mcap") == 2
    said = "track.mcap: expected the recording that was tracked, got what `handsight track` made of it: poses alone"
    assert capsys.readouterr().err == f"handsight: {said}\n"


@pytest.mark.skipif(find_spec("viser") is None, reason="the page needs handsight[view]")
def test_a_recording_that_is_none_leaves_no_page(folder, monkeypatch, capsys):
    (folder / "can.mcap").write_bytes(b"no recording")
    assert called(monkeypatch, folder, "view", "can.mcap") == 2
    assert "can.mcap: expected a recording" in capsys.readouterr().err
