"""Complete commands: a simulated search by touch, and the calibration of a camera."""

import contextlib
import io
import random
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator
from functools import cache
from importlib.util import find_spec
from itertools import islice
from pathlib import Path
from typing import Any
from unittest import mock

from ruamel.yaml import YAML

from handsight import se3, simulation
from handsight.cli import main
from handsight.cli.demo import DATA
from handsight.errors import HandsightError
from handsight.recording import RecordingWriter, open_recording
from handsight.rig import Rig
from handsight.simulation import GraspSearchResult, touch_search, write_grasp
from handsight.simulation.motion import CAN
from tests.corpus.door import NUMBERS, Case, Door, check_pose, spoilt_bytes, spoilt_text
from tests.corpus.object_files import ply

SAMPLES = 20
"""How much of a simulated search is recorded: the beginning of the first sweep."""


def command(*arguments: str) -> str:
    """Returns the stdout of a command; raises a HandsightError with its last sentence where it fails."""
    out, said, code = io.StringIO(), io.StringIO(), None
    with (
        warnings.catch_warnings(),
        mock.patch.object(warnings, "showwarning"),
        mock.patch.object(sys, "argv", ["handsight", *arguments]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(said),
    ):
        try:
            main()
        except SystemExit as ended:
            code = ended.code
    if code:
        raise HandsightError(said.getvalue().strip().splitlines()[-1].removeprefix("handsight: "))
    return out.getvalue()


def in_folder(files: dict[str, bytes], bring: Callable[[], None]) -> None:
    """Calls a function in a new folder with these files."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for name, data in files.items():
            Path(name).write_bytes(data)
        bring()


@cache
def grasp() -> str:
    """Returns the file of a grasp."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.grasp.json")
        write_grasp(GraspSearchResult(CAN, True, 1, "", ""), "can", path)
        return path.read_text()


def blind(*arguments: str, mesh: bytes = b"", hold: str = "") -> None:
    """Simulates the beginning of a search by touch, and asserts that the recording and its rig can be read."""
    complete = simulation.simulate_touch_search

    def begun(*given: Any) -> Iterator[simulation.Sample]:
        return islice(complete(*given), SAMPLES)

    def bring() -> None:
        with (
            mock.patch.object(simulation, "simulate_touch_search", begun),
            mock.patch.object(touch_search, "TABLE_PROBES", touch_search.TABLE_PROBES[:1]),
        ):
            command("simulate", "--blind", "-o", "a.mcap", *arguments)
        with open_recording("a.mcap", Rig.from_file("a.rig.yaml")) as recording:
            assert len(list(recording.observations())) >= SAMPLES - 2

    in_folder({"a.ply": mesh or ply(), "a.json": (hold or grasp()).encode("utf-8", "replace")}, bring)


def blind_spoilt(rng: random.Random) -> None:
    """Simulates a search with a nuisance of any size, a damaged mesh or grasp, or options that exclude each other."""
    kind = rng.randrange(4)
    if kind == 0:
        name = rng.choice(sorted(simulation.Nuisances.__slots__))
        blind("can", "--nuisance", f"{name}={rng.choice([*NUMBERS, 0.01, 0.01, 'x', ''])}")
    elif kind == 1:
        blind("a.ply", "--grasp", "a.json", mesh=spoilt_bytes(ply(), rng))
    elif kind == 2:
        blind("can", "--grasp", "a.json", hold=spoilt_text(grasp(), rng))
    else:
        options = [
            "--images",
            "--skin",
            "--sensors=xela",
            "--world=harsh",
            "--motion=ramp",
            "--plot=a.txt",
            "--seed=9999999999",
        ]
        blind(rng.choice(["can", "box", "no.ply"]), *rng.sample(options, 1))


@cache
def turned() -> tuple[bytes, str]:
    """Returns a recording in which the palm turns with the box, a few observations a second, and its rig's file."""
    robot = Rig.from_file(DATA / "box.rig.yaml")
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.mcap")
        with open_recording(DATA / "box.mcap", robot) as recording, RecordingWriter(path, robot) as writer:
            for observation in islice(recording.observations(), 0, 700, 10):
                writer.write(observation)
        return path.read_bytes(), (DATA / "box.rig.yaml").read_text()


def calibrated(data: bytes, rig: str) -> None:
    """Calibrates the camera by a recording, and asserts that the printed pose is one."""

    def bring() -> None:
        found = YAML(typ="safe").load(command("calibrate", "camera", "a.mcap", "--object", "box"))
        pose = found["camera"]["pose"]
        check_pose(se3.from_position_quaternion(pose["position"], pose["quaternion_xyzw"]))

    in_folder({"a.mcap": data, "a.rig.yaml": rig.encode("utf-8", "replace")}, bring)


def calibrated_spoilt(rng: random.Random) -> None:
    """Calibrates a camera by a damaged recording, or with a damaged rig."""
    data, rig = turned()
    if rng.random() < 0.5:
        calibrated(spoilt_bytes(data, rng), rig)
    else:
        calibrated(data, spoilt_text(rig, rng))


HAND = find_spec("mujoco") is not None and find_spec("gymnasium_robotics") is not None
DOORS = [Door("handsight calibrate camera", calibrated_spoilt, 4)]
DOORS += [Door("handsight simulate --blind", blind_spoilt, 4)] * HAND
CASES = [
    Case(
        "a camera calibrated by a cut recording",
        lambda: calibrated(turned()[0][:2000], turned()[1]),
        "a.mcap: ",
    ),
]
CASES += [
    Case(
        "a search by touch with a picture of no kind",
        lambda: blind("can", "--plot=a.txt"),
        "--plot: expected a name",
    ),
] * HAND
