"""What other programs say of images: what they write is read, what belongs to no image or object is told, and so is a pose
that cannot be."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis.extra.numpy import arrays

from handsight.camera import Camera
from handsight.errors import InvalidFile
from handsight.objects import ObjectModel
from handsight.recording.detection_file import RunLengths
from handsight.recording.frames import Frame, ImageName, Unread
from handsight.recording.hints import Hints, doubt_of
from testbed.refusals import refused

CAMERA = Camera(np.array([[50.0, 0, 8], [0, 50, 6], [0, 0, 1]]), (16, 12))
MASK = np.zeros((12, 16), bool)
MASK[3:7, 5:11] = True


def counts_of(mask):
    """COCO's run lengths: column by column, the first of pixels that are not in the mask."""
    pixels = mask.T.ravel()
    ends = np.flatnonzero(np.diff(pixels)) + 1
    runs = np.diff([0, *ends, pixels.size]).tolist()
    return [0, *runs] if pixels[0] else runs


@settings(max_examples=100, deadline=None)
@given(arrays(bool, (12, 16)))
def test_run_lengths_are_the_mask_they_were_made_of(mask):
    np.testing.assert_array_equal(RunLengths((12, 16), counts_of(mask)).mask(CAMERA), mask)


def entry(**changed):
    return {
        "scene_id": 48,
        "image_id": 1,
        "category_id": 3,
        "bbox": [5, 3, 5, 3],
        "score": 0.7,
        "time": 0.2,
    } | changed


CUP = ObjectModel.cylinder(0.04, 0.1)
MODELS = {"cup": CUP}
IMAGES = ImageName(48, "000001"), ImageName(48, "000004")


def frame(scene=48, stem="000001", **more):
    more.setdefault("depth", np.full((12, 16), 0.8, np.float32))
    return Frame(name=stem, camera=CAMERA, image=ImageName(scene, stem), **more)


def written(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def hints(
    path,
    content,
    kind="detections",
    numbers=(("3", "cup"),),
    images=IMAGES,
):
    return Hints(MODELS, dict(numbers), images, **{kind: written(path, content)})


def test_detections_are_those_of_the_object_in_the_image(tmp_path):
    rle = {"size": [12, 16], "counts": counts_of(MASK)}
    entries = [
        entry(segmentation=rle),
        entry(bbox=[0.5, 1.5, 3, 4], score=0),
        entry(category_id=7),
        entry(image_id=2),
        entry(image_id=4, category_id=7),
    ]
    given = hints(tmp_path / "a.json", entries)
    first, second = given.beside(frame()).detections
    assert (first.label, first.score, first.box) == ("cup", 0.7, (5, 3, 10, 6))
    np.testing.assert_array_equal(first.mask, MASK)
    assert (second.box, second.mask, second.score > 0) == ((0.5, 1.5, 3.5, 5.5), None, True)
    assert given.beside(frame(48, "000004")).detections == ()
    assert given.beside(frame(48, "000009")).detections == ()
    assert given.beside(frame(49, "000001")).detections == ()
    assert given.sentences == [f"{tmp_path / 'a.json'}: 2 of 5 rows are about these images and objects"]


@pytest.mark.parametrize("kind", ["results without a scene", "ground truth", "yolo"])
def test_detections_of_other_programs_are_the_same(tmp_path, kind):
    path = tmp_path / "a.json"
    if kind == "yolo":
        path = tmp_path / "labels"
        path.mkdir()
        (path / "frame_000001.txt").write_text("3 0.5 0.4166666 0.3125 0.25 0.7\n")
    elif kind == "ground truth":
        annotation = {
            "id": 1,
            "image_id": 77,
            "category_id": 3,
            "bbox": [5, 3, 5, 3],
            "segmentation": [[5, 3, 10, 3, 10, 6]],
            "iscrowd": 0,
        }
        images = [{"id": 77, "file_name": "rgb/frame_000001.jpg", "width": 16, "height": 12}]
        written(
            path,
            {
                "images": images,
                "annotations": [annotation],
                "categories": [{"id": 3, "name": "cup"}],
                "info": {},
            },
        )
    else:
        written(path, [{key: value for key, value in entry().items() if key != "scene_id"}])
    given = Hints(MODELS, {"3": "cup"}, [ImageName(None, "frame_000001")], detections=path)
    (found,) = given.beside(frame(None, "frame_000001")).detections
    assert found.label == "cup"
    np.testing.assert_allclose(found.box, (5, 3, 10, 6), atol=0.51)


@pytest.mark.parametrize("kind", ["detections", "start", "targets"])
def test_rows_that_match_no_image_are_an_error(tmp_path, kind):
    content = {
        "detections": [entry(image_id=9)],
        "start": "48,9,3,1,1 0 0 0 1 0 0 0 1,0 0 800,-1",
        "targets": [{"im_id": 9, "inst_count": 1, "obj_id": 3, "scene_id": 48}],
    }[kind]
    name = "a.csv" if kind == "start" else "a.json"
    with refused(InvalidFile, name):
        hints(tmp_path / name, content, kind)


def test_the_only_image_and_the_only_object_need_no_numbers(tmp_path):
    row = "0,0,5,1,1 0 0 0 1 0 0 0 1,0 0 800,-1"
    only = [ImageName(None, "depth")]
    given = hints(tmp_path / "a.csv", row, "start", numbers=(), images=only)
    assert given.beside(frame(None, "depth")).starts["cup"].shape == (1, 4, 4)
    with refused(InvalidFile, "a.csv"):
        hints(tmp_path / "a.csv", row, "start", images=only)  # an object of another number
    with refused(InvalidFile, "a.csv"):
        hints(tmp_path / "a.csv", row, "start", numbers=(), images=[ImageName(None, "depth_3")])


POSE = np.eye(4)
POSE[2, 3] = 0.85


@pytest.mark.parametrize(
    ("position", "word"),
    [
        ((0, 0, 0.85), ""),
        ((0, 0, 0.00085), "from the camera"),  # metres in a file of millimetres
        ((0, 0, -0.85), "behind the camera"),
        ((0, 0, 850.0), "behind what the image shows"),
        ((0, 0, 1.2), "behind what the image shows"),
        ((3.0, 0, 0.85), "outside the image"),
    ],
)
def test_a_pose_that_cannot_be_is_told_and_not_used(tmp_path, position, word):
    T = np.eye(4)
    T[:3, 3] = position
    doubt = doubt_of(T, CUP, frame())
    assert word in doubt
    assert bool(word) == bool(doubt)
    t = " ".join(str(1e3 * x) for x in position)
    given = hints(tmp_path / "a.csv", f"48,1,3,1,1 0 0 0 1 0 0 0 1,{t},-1", "start").beside(frame())
    assert (given.starts is None) == bool(word)
    assert (given.notes != ()) == bool(word)


def test_starts_are_the_best_poses_of_each_object(tmp_path):
    rows = [f"48,1,3,{k / 20},1 0 0 0 1 0 0 0 1,{k} 0 850,-1" for k in range(15)]
    starts = (
        hints(tmp_path / "a.csv", "\n".join([*rows, rows[0].replace(",3,", ",7,")]), "start")
        .beside(frame())
        .starts
    )
    assert list(starts) == ["cup"]
    np.testing.assert_allclose(starts["cup"][:, 0, 3], 1e-3 * np.arange(14, 4, -1))


def test_targets_say_how_often_each_object_is_in_which_image(tmp_path):
    rows = [
        {"im_id": 1, "inst_count": 2, "obj_id": 3, "scene_id": 48},
        {"im_id": 2, "inst_count": 1, "obj_id": 7, "scene_id": 48},
    ]
    given = hints(tmp_path / "a.json", rows, "targets")
    assert given.beside(frame()).targets == {"cup": 2}
    images = [frame(), frame(48, "000002"), frame(48, "000003"), Unread("x", "y")]
    assert [each.name for each in given.beside_each(images)] == ["000001", "x"]


RLE = {"size": [12, 16], "counts": [192]}
WRONG = {
    "truncated": ('[{"scene_id": 48,', "a.json"),
    "an object": ("{}", "file"),
    "no number": ([entry(), entry(scene_id="48")], "[1].scene_id"),
    "no category": ([{k: v for k, v in entry().items() if k != "category_id"}], "[0].category_id"),
    "not a number": ('[{"scene_id": 48, "image_id": 1, "category_id": 3, "bbox": [NaN, 1, 1, 1], "score": 1}]', "a.json"),
    "a box of three": ([entry(bbox=[1, 2, 3])], "[0].bbox"),
    "a box of less than nothing": ([entry(bbox=[5, 3, -1, 3])], "[0].bbox[2]"),
    "a huge box": ([entry(bbox=[0, 0, 1e308, 1e308])], "[0].bbox[2]"),
    "a score in percent": ([entry(score=97)], "[0].score"),
    "unknown classes": ([entry(category_id=99), entry(category_id=44)], "a.json"),
    "polygons": ([entry(segmentation=[[1, 2, 3]])], "[0].segmentation"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_file_that_is_none_is_refused_by_its_field(tmp_path, kind):
    content, field = WRONG[kind]
    with refused(InvalidFile, field):
        hints(tmp_path / "a.json", content)


WRONG_IN_IMAGE = {
    "a box outside": ({"bbox": [16, 3, 5, 3]}, "box: expected u0,v0,u1,v1 that meets the image"),
    "a mask of another image": ({"segmentation": RLE | {"size": [16, 12]}}, "size: expected 12 rows, 16 columns"),
    "a mask of too few pixels": ({"segmentation": RLE | {"counts": [10, 20]}}, "counts: expected runs of 192 pixels"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG_IN_IMAGE)
def test_a_detection_that_the_image_cannot_have_is_one_sentence(tmp_path, kind):
    changed, message = WRONG_IN_IMAGE[kind]
    given = hints(tmp_path / "a.json", [entry(**changed)])
    (unread,) = given.beside_each([frame()])
    assert message in unread.reason
