"""`handsight locate`: an object found in pictures of each kind, what is not there, and what is wrong with files."""

import csv
import json
import re
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

import handsight as hs
from cli.commands import called, run
from handsight import se3
from handsight.cli.locate import MAX_INSTANCES
from handsight.vision.object import locate as locating
from handsight.vision.object.appearance import appearance_of
from handsight.vision.object.locate import MIN_PROBABILITY
from testbed.picture_files import (
    INTRINSICS,
    bop_of,
    brick,
    folder_of,
    off_mm,
    picture,
    three_touching,
    write_color,
    write_depth,
    write_mesh,
)
from testbed.sight_scenes import CAMERA, letter

NEAR_MM = 12.0
"""A tenth of the letter's diameter."""


def pose_of(answer):
    return se3.from_position_quaternion(answer["position"], answer["quaternion_xyzw"])


def answers(out):
    return [json.loads(line) for line in out.splitlines()]


JSON = ("-o", "-")


@pytest.fixture(scope="module")
def pictures():
    return [picture(0), picture(1), picture(2, empty=True)]


@pytest.fixture
def frames(pictures, tmp_path):
    """A folder of three: the letter is in the first two."""
    return folder_of(tmp_path, [depth for depth, _ in pictures])


@pytest.fixture
def scene(pictures, tmp_path):
    return bop_of(tmp_path / "bop", [depth for depth, _ in pictures])


def test_an_object_is_found_in_a_folder_of_pictures_and_not_where_it_is_not(frames, pictures, asked):
    out, _ = asked("locate", frames, "--object", "letter.ply", "--plot", "found.png", *JSON)
    first, second, third = answers(out)
    for answer, name, (_, truth) in zip((first, second), ("0000.png", "0001.png"), pictures, strict=False):
        assert (answer["frame"], answer["object"], answer["found"]) == (name, "letter", True)
        assert off_mm(pose_of(answer), truth) < NEAR_MM
        assert np.linalg.eigvalsh(answer["covariance"]).min() > 0
        best = answer["hypotheses"][0]
        assert best["position"] == answer["position"]
        assert best["weight"] == max(each["weight"] for each in answer["hypotheses"])
        assert MIN_PROBABILITY <= answer["probability"] <= 1
        assert answer["seconds"] > 0
    assert set(third) == {"frame", "object", "found", "reason", "seconds"}
    assert third["found"] is False
    assert (frames.parent / "found.png").read_bytes().startswith(b"\x89PNG")
    for answer in (first, second):
        weights = [each["weight"] for each in answer["hypotheses"]]
        assert len(weights) <= 3
        assert weights == sorted(weights, reverse=True)


def test_one_picture_needs_no_more_than_its_camera_and_a_mesh(pictures, tmp_path):
    """As a user runs it, in a process of its own; the mesh in millimetres, depth in tenths of them."""
    depth, truth = pictures[0]
    write_depth(tmp_path / "a.png", depth, 1e-4)
    write_mesh(tmp_path / "letter.ply", 1000.0)
    (tmp_path / "d435.json").write_text(json.dumps(INTRINSICS))
    arguments = ("--camera", "d435.json", "--depth-scale", "0.0001", "--scale", "0.001")
    out, said = run("locate", "a.png", "--object", "letter.ply", *arguments, "-o", "out.jsonl", cwd=tmp_path)
    assert out == ""
    assert said == "wrote out.jsonl: found in 1 of 1 images\n"
    (answer,) = answers((tmp_path / "out.jsonl").read_text())
    assert off_mm(pose_of(answer), truth) < NEAR_MM


def test_a_bop_scene_is_answered_in_bops_csv(scene, pictures, asked):
    """Models and depth's unit are the data set's own; a picture without the object has no line."""
    for place in (scene, scene.parent):
        asked("locate", place, "--object", "3", "-o", "results.csv")
        with open(scene.parents[2] / "results.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        assert list(rows[0]) == ["scene_id", "im_id", "obj_id", "score", "R", "t", "time"]
        assert [(row["scene_id"], row["im_id"], row["obj_id"]) for row in rows] == [
            ("48", "0", "3"),
            ("48", "1", "3"),
        ]
        for row, (_, truth) in zip(rows, pictures, strict=False):
            R = np.array(row["R"].split(), float).reshape(3, 3)
            T = se3.compose(R, 1e-3 * np.array(row["t"].split(), float))
            np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-5)
            assert off_mm(T, truth) < NEAR_MM
            assert 0 < float(row["score"]) <= 1
            assert float(row["time"]) > 0
    out, _ = asked("locate", scene, "--object", "obj_000003", *JSON)
    assert [(each["scene_id"], each["im_id"], each["found"]) for each in answers(out)] == [
        (48, 0, True),
        (48, 1, True),
        (48, 2, False),
    ]


@pytest.fixture
def two_known(pictures, tmp_path):
    """A BOP scene of a data set with two objects: letter, brick, and none of them."""
    depths = [pictures[0][0], picture(1, shape=brick)[0], pictures[2][0]]
    return bop_of(tmp_path / "two", depths, {3: letter, 7: brick})


SHOWN = ["obj_000003", "obj_000007", None]


def test_of_all_objects_of_a_data_set_it_is_said_which(two_known, pictures, asked):
    out, _ = asked("locate", two_known, "--which", "--plot", "which.png", *JSON)
    rows = answers(out)
    for row, name in zip(rows, SHOWN, strict=True):
        assert (row["object"], row["found"]) == (name, name is not None)
        assert set(row["scores"]) == {"obj_000003", "obj_000007"}
        assert sum(row["scores"].values()) + row["none"] == pytest.approx(1)
        assert max(row["scores"] | {None: row["none"]}, key=(row["scores"] | {None: row["none"]}).get) == name
    assert off_mm(pose_of(rows[0]), pictures[0][1]) < NEAR_MM
    assert set(rows[2]) == {
        "scene_id",
        "im_id",
        "frame",
        "object",
        "found",
        "scores",
        "none",
        "reason",
        "seconds",
    }
    out, _ = asked("locate", two_known, "--object", "7", "--object", "3", "--which", *JSON)
    assert [row["scores"] for row in answers(out)] == [row["scores"] for row in rows]
    asked("locate", two_known, "--which", "-o", "which.csv")
    with open(two_known.parents[2] / "which.csv", newline="") as file:
        assert [(row["im_id"], row["obj_id"]) for row in csv.DictReader(file)] == [("0", "3"), ("1", "7")]


def test_without_an_object_all_of_the_library_are_asked_for(frames, two_known, asked, monkeypatch):
    library = two_known.parents[1]
    picture = ("frames/depth/0000.png", "--camera", "frames/camera.json", "--which")
    out, _ = asked("locate", *picture, "--library", library, *JSON)
    (answer,) = answers(out)
    assert answer["object"] == "obj_000003"
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(library))
    (again,) = answers(asked("locate", *picture, *JSON)[0])
    assert again["scores"] == answer["scores"]
    (mixed,) = answers(asked("locate", *picture, "--object", "7", "--object", "letter.ply", *JSON)[0])
    assert (mixed["object"], set(mixed["scores"])) == ("letter", {"obj_000007", "letter"})
    (library / "models/models_info.json").write_text("{}")
    _, err = asked("locate", *picture, expect=2)
    assert err == (
        "handsight: --object: expected a name of the library or a mesh file, got nothing; "
        f"{library} has none\n"
    )


def test_what_kind_of_camera_it_is_matters_to_the_covariance(frames, asked):
    """Time of flight is off by millimetres in all pixels alike, which no number of them takes away."""
    spread = {}
    for kind in ("structured_light", "time_of_flight"):
        told = ("--object", "letter.ply", "--depth-camera", kind)
        (answer,) = answers(
            asked("locate", "frames/depth/0000.png", "--camera", "frames/camera.json", *told, *JSON)[0]
        )
        spread[kind] = np.trace(np.array(answer["covariance"])[:3, :3])
    (untold,) = answers(
        asked(
            "locate",
            "frames/depth/0000.png",
            "--camera",
            "frames/camera.json",
            "--object",
            "letter.ply",
            *JSON,
        )[0]
    )
    assert np.trace(np.array(untold["covariance"])[:3, :3]) == spread["structured_light"]
    assert spread["time_of_flight"] > 2 * spread["structured_light"]


def test_an_object_is_searched_for_only_in_a_box_or_a_mask(frames, pictures, asked):
    """Around it it is found; where it is not, it is not, though it is in the picture."""
    _, truth = pictures[0]
    u, v = CAMERA.project(truth[None, :3, 3])[0].round().astype(int)
    around = [max(u - 80, 0), max(v - 80, 0), min(u + 80, 319), min(v + 80, 239)]
    beside = [0, 0, 20, 20]
    for name, box in (("around", around), ("beside", beside)):
        mask = np.zeros((240, 320), np.uint8)
        mask[box[1] : box[3] + 1, box[0] : box[2] + 1] = 255
        (frames / name).mkdir()
        Image.fromarray(mask).save(frames / name / "0000.png")
        found = []
        for option in (("--box", ",".join(map(str, box))), ("--mask", frames / name)):
            depth = frames / "depth/0000.png"
            camera = ("--camera", frames / "camera.json", "--object", "letter.ply")
            (answer,) = answers(asked("locate", depth, *camera, *option, *JSON)[0])
            found.append(answer["found"] and off_mm(pose_of(answer), truth) < NEAR_MM)
        assert found == [name == "around"] * 2


def box_of(truth, by=60):
    u, v = CAMERA.project(truth[None, :3, 3])[0].tolist()
    return [u - by, v - by, 2 * by, 2 * by]


def test_detections_and_poses_of_others_are_searched(scene, pictures, asked, tmp_path):
    """The first image has a wrong detection and a right one; the second a pose that is right and one beside it."""
    (_, first), (_, second) = pictures[:2]
    far = [0, 0, 20, 20]
    entries = [
        {"scene_id": 48, "image_id": image, "category_id": 3, "bbox": box, "score": score, "time": 0.1}
        for image, box, score in ((0, far, 0.9), (0, box_of(first), 0.4), (1, far, 0.5))
    ]
    (tmp_path / "found.json").write_text(json.dumps(entries))
    rows = answers(asked("locate", scene, "--object", "3", "--detections", "found.json", *JSON)[0])
    assert [row["found"] for row in rows] == [True, False, False]
    assert off_mm(pose_of(rows[0]), first) < NEAR_MM
    assert rows[2]["reason"].startswith("obj_000003 was not detected in the image")

    beside = se3.moved(second, np.array([0.2, 0, 0, 0, 0, 0.3]))
    lines = [
        f"48,1,3,{score},"
        + ",".join(" ".join(map(str, part.ravel())) for part in (T[:3, :3], 1e3 * T[:3, 3]))
        + ",-1"
        for score, T in ((0.5, second), (0.9, beside))
    ]
    (tmp_path / "poses.csv").write_text("\n".join(["scene_id,im_id,obj_id,score,R,t,time", *lines]))
    rows = answers(asked("locate", scene, "--object", "3", "--start", "poses.csv", *JSON)[0])
    assert off_mm(pose_of(rows[1]), second) < NEAR_MM

    targets = [{"scene_id": 48, "im_id": 1, "obj_id": 3, "inst_count": 1}]
    (tmp_path / "targets.json").write_text(json.dumps(targets))
    (row,) = answers(asked("locate", scene, "--object", "3", "--targets", "targets.json", *JSON)[0])
    assert (row["im_id"], row["found"]) == (1, True)


def test_several_objects_are_named_by_their_detections(two_known, pictures, asked, tmp_path):
    entries = [
        {"scene_id": 48, "image_id": image, "category_id": number, "bbox": [0, 0, 319, 239], "score": 0.5}
        for image, number in ((0, 3), (1, 3), (1, 7))
    ]
    (tmp_path / "found.json").write_text(json.dumps(entries))
    rows = answers(asked("locate", two_known, "--detections", "found.json", "--which", *JSON)[0])
    assert [row["object"] for row in rows] == SHOWN
    assert rows[0]["scores"]["obj_000007"] == 0
    rows = answers(asked("locate", two_known, "--detections", "found.json", *JSON)[0])
    assert [[each["object"] for each in row["objects"]] for row in rows] == [[SHOWN[0]], [SHOWN[1]], []]
    assert set(rows[2]["missing"]) == {*SHOWN[:2]}


def test_masks_of_instances_are_those_of_their_objects(scene, pictures, asked, tmp_path):
    """mask_visib/IMAGE_INSTANCE.png: the first instance is of another object."""
    (scene / "mask_visib").mkdir()
    u, v, w, h = map(int, box_of(pictures[0][1]))
    around, other = np.zeros((240, 320), np.uint8), np.zeros((240, 320), np.uint8)
    around[max(v, 0) : v + h, max(u, 0) : u + w], other[:30, :30] = 255, 255
    for image in range(3):
        Image.fromarray(other).save(scene / f"mask_visib/{image:06d}_000000.png")
    Image.fromarray(around).save(scene / "mask_visib/000000_000001.png")
    (scene / "scene_gt.json").write_text(
        json.dumps({"0": [{"obj_id": 7}, {"obj_id": 3}], "1": [{"obj_id": 3}]})
    )
    for place in ("mask_visib", scene / "mask_visib"):
        rows = answers(asked("locate", scene, "--object", "3", "--mask", place, *JSON)[0])
        assert [row["found"] for row in rows] == [True, False, False]
        assert off_mm(pose_of(rows[0]), pictures[0][1]) < NEAR_MM


def test_a_picture_that_cannot_be_read_is_said_in_its_place(frames, scene, asked):
    (frames / "depth/0001.png").write_bytes(b"no picture")
    out, said = asked("locate", frames, "--object", "letter.ply", *JSON, expect=1)
    first, second, third = answers(out)
    assert first["found"]
    assert not third["found"]
    assert re.search(r"depth/0001.png: expected a PNG or TIFF", second["error"])
    assert said.endswith(f"handsight: {second['error']}\n")
    (scene / "depth/000001.png").unlink()
    _, said = asked("locate", scene, "--object", "3", "-o", "out.csv", expect=1)
    assert re.search(r"handsight: .*depth/000001.png: cannot be read: No such file or directory", said)
    assert "wrote out.csv: found in 1 of 3 images" in said


def camera(**changed):
    return lambda frames: (frames / "camera.json").write_text(json.dumps(INTRINSICS | changed))


def saved(name, pixels):
    return lambda frames: Image.fromarray(pixels).save(frames / name)


FIRST, NONE = "depth/0000.png", lambda frames: None
WRONG = {
    "depth in metres": (lambda f: write_depth(f / FIRST, picture(0)[0], 0.5), (), FIRST),
    "8 bits": (saved(FIRST, np.full((240, 320), 90, np.uint8)), (), FIRST),
    "no depth": (saved(FIRST, np.zeros((240, 320), np.uint16)), (), FIRST),
    "camera of another size": (camera(width=640, height=480), (), "camera.json: size"),
    "camera with a slip": (camera(lenses=[0.1] * 4), (), "camera.json: lenses"),
    "no camera": (lambda f: (f / "camera.json").unlink(), (), "camera.json"),
    "colour of another size": (lambda f: write_color(f / "rgb/0000.png", (64, 48)), (), "rgb/0000.png"),
    "a mask of another size": (
        lambda f: write_color(f / "m.png", (64, 48)),
        ("--mask", "frames/m.png"),
        "m.png",
    ),
    "a box beyond": (NONE, ("--box", "320,0,400,100"), "box"),
    "no box": (NONE, ("--box", "left"), "--box"),
    "a rig": (NONE, ("--rig", "rig.yaml"), "--rig"),
    "no such depth camera": (NONE, ("--depth-camera", "sterio"), "--depth-camera"),
    "two objects of one name": (
        lambda f: write_mesh(f / "letter.ply"),
        ("--object", "frames/letter.ply"),
        "--object",
    ),
    "one of several that nobody knows": (NONE, ("--object", "mug"), "--object"),
    "a scale of nothing": (NONE, ("--depth-scale", "0"), "scale"),
}
"""What is spoiled, the options, and what is named."""


def only_first(folder):
    """Of three images the first is kept."""
    for path in (*folder.glob("*/000[12].png"), *folder.glob("*/00000[12].png")):
        path.unlink()


def refusal(asked, *arguments):
    """What a command says that refuses its input: one line, after what was taken for what."""
    _, err = asked("locate", *arguments, expect=2)
    *taken, line = err.splitlines()
    assert line.startswith("handsight: ")
    assert all(": took " in each or " rows are about these " in each for each in taken)
    return f"{line}\n"


@pytest.mark.parametrize("kind", WRONG)
def test_what_is_wrong_with_a_folder_is_named(frames, asked, kind):
    spoil, options, named = WRONG[kind]
    only_first(frames)
    spoil(frames)
    assert f"{named}: " in refusal(asked, "frames", "--object", "letter.ply", *options)


CAMERAS, MODEL = "scene_camera.json", "models/obj_000003.ply"
ENTRY = {"scene_id": 48, "image_id": 0, "category_id": 3, "bbox": [0, 0, 9, 9], "score": 1}
WRONG_BOP = {
    "a missing model": (lambda s: (s.parents[1] / MODEL).unlink(), (), MODEL),
    "a matrix of eight": ({"cam_K": [1.0] * 8}, (), f"{CAMERAS}: 0.cam_K"),
    "a matrix of nothing": ({"cam_K": [0.0] * 9}, (), f"{CAMERAS}: 0.cam_K"),
    "no unit": ({"depth_scale": None}, (), f"{CAMERAS}: 0.depth_scale"),
    "a scene of nothing": (lambda s: (s / CAMERAS).write_text("{}"), (), CAMERAS),
    "other columns": ("frame,x,y,z\n1,2,3,4\n", ("--start", "a"), "a"),
    "a row that was cut": ("48,1,3,0.5,1 0 0,", ("--start", "a"), "a: line 1"),
    "unknown classes": (json.dumps([ENTRY | {"category_id": 90}]), ("--detections", "a"), "a"),
    "a box outside": (json.dumps([ENTRY | {"bbox": [320, 0, 9, 9]}]), ("--detections", "a"), "box"),
    "an unknown target": ('[{"scene_id": 48, "im_id": 0, "obj_id": 90}]', ("--targets", "a"), "a"),
    "truncated": ('[{"scene_id": 48', ("--targets", "a"), "a"),
    "no file": ("", ("--detections", "b"), "b"),
}
"""Keys of the camera or what else is spoiled, or the text of a file of hints; the options; what is named."""


@pytest.mark.parametrize("kind", WRONG_BOP)
def test_what_is_wrong_with_a_bop_scene_is_named(scene, asked, tmp_path, kind):
    spoil, options, named = WRONG_BOP[kind]
    only_first(scene)
    cameras = {"0": json.loads((scene / CAMERAS).read_text())["0"]}
    (scene / CAMERAS).write_text(json.dumps({"0": cameras["0"] | (spoil if isinstance(spoil, dict) else {})}))
    if callable(spoil):
        spoil(scene)
    (tmp_path / "a").write_text(spoil if isinstance(spoil, str) else "")
    assert f"{named}: " in refusal(asked, scene, "--object", "3", *options)


def test_what_is_no_picture_is_said(asked, tmp_path, monkeypatch):
    monkeypatch.setenv("HANDSIGHT_LIBRARY", str(tmp_path / "none"))
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.png").write_bytes(b"")
    (tmp_path / "camera.json").write_text(json.dumps(INTRINSICS))
    for arguments, said in (
        (("locate", "empty", "--object", "a"), "empty: expected depth images"),
        (("locate", "away.png", "--object", "a"), "away.png: cannot be read: No such file or directory"),
        (("locate", "a.mcap"), "--rig: expected a rig file, got nothing, and there is neither a.rig.yaml nor rig.yaml beside a.mcap"),
        (("locate", "a.png", "--object", "a", "-o", "a.png"), "a.png: the answers would overwrite what is read"),
    ):  # fmt: skip
        _, err = asked(*arguments, expect=2)
        assert err.startswith(f"handsight: {said}")
    write_depth(tmp_path / "a.png", picture(0)[0])
    _, err = asked("locate", "a.png", "--object", "a", expect=2)
    assert err.startswith("handsight: --object: expected a name of a library (there is none at ")
    _, err = asked("locate", "a.png", expect=2)
    said = "--object: expected a name of the library or a mesh file, got nothing"
    assert err == f"handsight: {said}; {tmp_path / 'none'} has none\n"
    write_mesh(tmp_path / "letter.ply")
    _, err = asked("locate", "a.png", "--object", "letter.ply", "-o", "away/b.jsonl", expect=74)
    assert err.startswith("handsight: away/b.jsonl: cannot be written: No such file or directory")


@pytest.mark.parametrize("interrupted_at", [0, 1])
def test_after_ctrl_c_an_earlier_file_stands_and_what_was_found_is_beside_it(
    frames, monkeypatch, interrupted_at
):
    calls, locate = iter(range(9)), locating.locate

    def interrupted(*args, **options):
        if next(calls) == interrupted_at:
            raise KeyboardInterrupt
        return locate(*args, **options)

    monkeypatch.setattr(locating, "locate", interrupted)
    folder = frames.parent
    (folder / "a.jsonl").write_text("as it was")
    assert called(monkeypatch, folder, "locate", "frames", "--object", "letter.ply", "-o", "a.jsonl") == 130
    assert (folder / "a.jsonl").read_text() == "as it was"
    part = folder / "a.jsonl.part"
    assert part.exists() == bool(interrupted_at)
    if part.exists():
        assert len(answers(part.read_text())) == 1


POSE = re.compile(
    r"(?P<frame>\S+): (?P<object>\S+) at \[(?P<position>[^]]+)\] mm ± [\d.]+, turned \[(?P<turn>[^]]+)\] \(xyzw\) "
    r"± [\d.]+°, probability (?P<probability>[\d.]+)(; or .+)?"
)


def assert_said_shortly(line, frame, answer):
    """A line has an answer's pose and probability."""
    said = POSE.fullmatch(line)
    assert said, line
    assert (said["frame"], said["object"]) == (frame, answer["object"])
    position = [float(x) for x in said["position"].split(", ")]
    np.testing.assert_allclose(position, 1e3 * np.array(answer["position"]), atol=0.051)
    np.testing.assert_allclose(
        [float(x) for x in said["turn"].split(", ")], answer["quaternion_xyzw"], atol=6e-4
    )
    assert float(said["probability"]) == pytest.approx(answer["probability"], abs=0.006)


def test_without_a_file_an_image_is_a_short_line(frames, asked):
    (frames / "depth/0001.png").write_bytes(b"no picture")
    given = ("locate", "frames", "--object", "letter.ply")
    out, said = asked(*given, expect=1)
    first, second, third = out.splitlines()
    assert "took depth/ for depth" in said
    assert_said_shortly(first, "0000.png", answers(asked(*given, *JSON, expect=1)[0])[0])
    assert second.endswith("0001.png: cannot be read")
    assert third.startswith("0002.png: not here: ")
    assert all(len(line) < 160 for line in out.splitlines())


TWO_BRICKS = ("--object", "7*2", "--object", "3")


@pytest.fixture
def crowd(tmp_path):
    """A BOP scene of a letter and two equal bricks that touch it, and of the table alone; and the true poses."""
    depth, truths = three_touching(3)
    return bop_of(tmp_path / "crowd", [depth, picture(2, empty=True)[0]], {3: letter, 7: brick}), truths


def test_each_object_that_is_there_is_answered_once(crowd, asked):
    """Two equal bricks are two answers, at two places, in JSON and in BOP's lines."""
    scene, truths = crowd
    first, second = answers(asked("locate", scene, *TWO_BRICKS, "--plot", "all.png", *JSON)[0])
    assert sorted(each["object"] for each in first["objects"]) == SHOWN[:1] + 2 * SHOWN[1:2]
    assert first["found"]
    assert first["missing"] == {}
    for each in first["objects"]:
        inside = np.array([[0, 0, 0.0175]])  # the middle of a brick, which looks alike upside down
        middle = se3.apply(pose_of(each), inside)
        truth = [se3.apply(T, inside) for name, T in truths if name == each["object"]]
        assert min(np.linalg.norm(middle - place) for place in truth) < 0.01
        assert np.linalg.eigvalsh(each["covariance"]).min() > 0
        assert MIN_PROBABILITY <= each["probability"] <= 1
        assert each["pixels"] > 100
        assert 1 <= len(each["hypotheses"]) <= 3
    bricks = [each["position"] for each in first["objects"] if each["object"] == SHOWN[1]]
    assert np.linalg.norm(np.subtract(*bricks)) > 0.05
    assert (second["found"], second["objects"], set(second["missing"])) == (False, [], {*SHOWN[:2]})
    assert (scene.parents[2] / "all.png").read_bytes().startswith(b"\x89PNG")
    asked("locate", scene, *TWO_BRICKS, "-o", "all.csv")
    with open(scene.parents[2] / "all.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(row["im_id"], row["obj_id"]) for row in sorted(rows, key=lambda row: row["obj_id"])] == [
        ("0", "3"), ("0", "7"), ("0", "7")
    ]  # fmt: skip
    assert len({row["time"] for row in rows}) == 1  # BOP asks for the time of the image


def test_there_are_as_many_as_are_declared_at_most(crowd, asked, tmp_path):
    scene, _ = crowd

    def found(*options):
        row, *_ = answers(asked("locate", scene, *options, *JSON)[0])
        return sorted(each["object"] for each in row["objects"])

    assert found() == found("--object", "7*1", "--object", "3") == SHOWN[:2]
    assert found(*TWO_BRICKS) == SHOWN[:1] + 2 * SHOWN[1:2]
    targets = [
        {"scene_id": 48, "im_id": 0, "obj_id": number, "inst_count": count}
        for number, count in ((3, 1), (7, 2))
    ]
    (tmp_path / "targets.json").write_text(json.dumps(targets))
    assert found("--targets", "targets.json") == SHOWN[:1] + 2 * SHOWN[1:2]
    for wrong in ("7*0", "7*x", "7*-1", "7*1e9"):
        _, err = asked("locate", scene, "--object", wrong, expect=2)
        assert err == (
            f"handsight: --object: expected NAME*N with a number from 1 to {MAX_INSTANCES}, got {wrong!r}\n"
        )


def test_a_short_line_for_each_object_that_is_there_and_for_each_that_is_not(crowd, asked):
    given = ("locate", crowd[0], *TWO_BRICKS)
    lines = asked(*given)[0].splitlines()
    there, empty = answers(asked(*given, *JSON)[0])
    for line, answer in zip(lines, there["objects"], strict=False):
        assert_said_shortly(line, there["frame"], answer)
    absent = [f"{empty['frame']}: {name} is not here: {why}" for name, why in empty["missing"].items()]
    assert lines[len(there["objects"]) :] == absent


@pytest.fixture(scope="module")
def held(made_once):
    """A rig, the last images of a simulated grasp, and where the camera truly is: T_camera_world.

    The rig has the camera 5 cm beside it.
    """
    pytest.importorskip("mujoco")
    pytest.importorskip("gymnasium_robotics", reason="the Shadow hand comes with gymnasium-robotics")
    from handsight.simulation import Scenario, rig_of, simulate, true_camera

    scenario = Scenario(object="box", rate=20, images=True)
    last = made_once("a box with images, the last three", lambda: list(simulate(scenario))[-3:])
    return rig_of(scenario), last, true_camera(scenario)


@pytest.mark.slow
def test_an_object_in_the_hand_is_found_in_a_recording(held, asked, tmp_path):
    from handsight.recording import RecordingWriter
    from handsight.rig.save import write as write_rig

    rig, samples, T_camera_world = held
    with RecordingWriter(tmp_path / "box.mcap", rig) as writer:
        for sample in samples:
            writer.write(sample.observation)
    write_rig(rig, tmp_path / "box.rig.yaml")
    out, _ = asked("locate", "box.mcap", "--object", "box", "--plot", "found.png", *JSON)
    rows = answers(out)
    assert len(rows) == sum(sample.observation.depth is not None for sample in samples)
    T_camera_object = T_camera_world @ samples[-1].T_world_object
    assert rows[-1]["found"]
    assert 1e3 * np.linalg.norm(pose_of(rows[-1])[:3, 3] - T_camera_object[:3, 3]) < 10
    assert (tmp_path / "found.png").stat().st_size > 20_000
    _, err = asked("locate", "box.mcap", "--object", "bx", expect=2)
    assert err.startswith("handsight: --object: expected a name of box.rig.yaml or a mesh file, got 'bx'")
    for option in (("--camera", "a.json"), ("-o", "a.csv"), ("--depth-camera", "stereo")):
        assert "expected" in asked("locate", "box.mcap", "--object", "box", *option, expect=2)[1]


@pytest.mark.slow
def test_recorded_detections_say_where_an_object_is_in_a_recording(held, asked, tmp_path):
    """Its label is the rig's; a box in a corner has nothing in it."""
    from handsight.messages import RosType
    from handsight.messages.encode import Message, header, pose_with_covariance
    from handsight.recording import RecordingWriter
    from handsight.rig.save import write as write_rig

    rig, samples, T_camera_world = held
    rig = replace(
        rig,
        topics=replace(rig.topics, detections="/boxes"),
        objects={"box": replace(rig.objects["box"], label="41")},
    )
    T = T_camera_world @ samples[-1].T_world_object
    u, v = hs.Camera.of(rig.camera).project(T[None, :3, 3])[0]
    for (x, y), there in (((u, v), True), ((10.0, 10.0), False)):
        with RecordingWriter(tmp_path / "box.mcap", rig) as writer:
            for sample in samples:
                stamp = sample.observation.stamp
                center = Message(position=Message(x=x, y=y), theta=0.0)
                box = Message(center=center, size_x=120.0 if there else 16.0, size_y=120.0 if there else 16.0)
                what = Message(
                    hypothesis=Message(class_id="41", score=0.8), pose=pose_with_covariance(np.eye(4), None)
                )
                one = Message(header=header(stamp), results=[what], bbox=box, id="")
                writer.append("/boxes", RosType.DETECTIONS, stamp, header=header(stamp), detections=[one])
                writer.write(sample.observation)
        write_rig(rig, tmp_path / "box.rig.yaml")
        row = answers(asked("locate", "box.mcap", "--object", "box", *JSON)[0])[-1]
        assert row["found"] == there
        if there:
            assert 1e3 * np.linalg.norm(pose_of(row)[:3, 3] - T[:3, 3]) < 10


@pytest.mark.slow
def test_the_hand_is_masked_where_it_is_though_the_camera_is_elsewhere(held, tmp_path):
    from handsight.recording import RecordingWriter
    from handsight.recording.frames import Frame, recorded_frames

    rig, samples, T_camera_world = held
    with RecordingWriter(tmp_path / "box.mcap", rig) as writer:
        for sample in samples:
            writer.write(sample.observation)
    frame = list(recorded_frames(tmp_path / "box.mcap", rig).each)[-1]
    assert isinstance(frame, Frame)
    links = rig.hand.surface(200).points_palm(samples[-1].observation.joint_positions)
    T_world_palm = samples[-1].T_world_object @ se3.inverse(samples[-1].T_palm_object)
    seen = se3.apply(T_camera_world @ T_world_palm, links)
    pixels = frame.camera.project(seen).round().astype(int)
    # Of the hand's points, those that nothing is before.
    measured = np.nan_to_num(frame.depth)[pixels[:, 1], pixels[:, 0]]
    bare = np.abs(measured - seen[:, 2]) < 0.01
    assert bare.sum() > 20
    assert frame.hand[pixels[bare, 1], pixels[bare, 0]].mean() > 0.95


def test_an_image_is_answered_before_what_it_does_not_need_is_loaded(frames, tmp_path):
    """A second of imports for 30 ms of work: no slow part of SciPy, no mesh library, no tracker; nor with a picture."""
    image, mesh = frames / "depth/0000.png", frames.parent / "letter.ply"
    appearance_of(hs.ObjectModel.from_file(mesh))  # into the cache
    program = (
        "import sys\n"
        f"sys.argv = ['handsight', 'locate', {str(image)!r}, '--camera', {str(frames / 'camera.json')!r}, '--object', {str(mesh)!r}, '-o', '-']\n"
        "from handsight.cli import main\n"
        "heavy = {'scipy.signal', 'scipy.stats', 'scipy.ndimage', 'scipy.spatial', 'trimesh', 'rich.console', 'handsight.tracking'}\n"
        "for more in ('matplotlib', 'matplotlib.pyplot'):\n"
        "    try: main()\n"
        "    except SystemExit as end: assert not end.code\n"
        "    loaded = {*heavy, more} & set(sys.modules)\n"
        "    assert not loaded, loaded\n"
        f"    sys.argv += ['--plot', {str(tmp_path / 'found.png')!r}]\n"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, timeout=300)
    assert done.returncode == 0, done.stderr.decode()
    assert all(json.loads(line)["found"] for line in done.stdout.splitlines())
    assert (tmp_path / "found.png").stat().st_size > 5_000


def test_depth_of_another_unit_says_so_beside_its_probability(frames, asked):
    for scale, hint in (
        (0.01, "in tenths of millimetres? then --depth-scale 0.0001"),
        (0.0005, "if that is not the distance of the scene, set --depth-scale"),
    ):
        out, _ = asked("locate", frames, "--object", "letter.ply", "--depth-scale", scale, *JSON)
        answer = answers(out)[0]
        assert not answer["found"]
        assert re.search(rf"\(median depth \d+\.\d\d m; {re.escape(hint)}\)$", answer["reason"]), answer[
            "reason"
        ]


def test_the_unit_of_depth_in_the_cameras_file_is_used_and_said_unless_it_cannot_be_or_an_option_wins(
    pictures, asked, tmp_path
):
    """The camera's file is in the folder above, which is said too."""
    depth, truth = pictures[0]
    (tmp_path / "shots").mkdir()
    write_depth(tmp_path / "shots" / "a.png", depth, 2.5e-4)
    write_mesh(tmp_path / "letter.ply")
    (tmp_path / "camera.json").write_text(json.dumps({**INTRINSICS, "depth_scale": 2.5e-4}))
    arguments = "locate", "shots/a.png", "--object", "letter.ply"
    out, said = asked(*arguments, *JSON)
    assert off_mm(pose_of(answers(out)[0]), truth) < NEAR_MM
    assert "depth_scale" in said
    assert str(tmp_path / "camera.json") in said or "camera.json for the camera" in said
    write_depth(tmp_path / "shots" / "mm.png", depth, 1e-3)
    out, said = asked("locate", "shots/mm.png", "--object", "letter.ply", *JSON)
    assert off_mm(pose_of(answers(out)[0]), truth) < NEAR_MM
    assert "does not fit" in said
    (tmp_path / "camera.json").write_text(json.dumps({**INTRINSICS, "depth_scale": 1000}))
    out, said = asked(*arguments, "--depth-scale", "0.00025", *JSON)
    assert off_mm(pose_of(answers(out)[0]), truth) < NEAR_MM
    assert "--depth-scale" in said
