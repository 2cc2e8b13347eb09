"""What other programs say of images, in BOP's files: what they write is read, and what is wrong is said with its field."""

import contextlib
import json
import re

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from handsight.camera import Camera
from handsight.errors import InvalidFile, InvalidInput
from handsight.recording.bop import Hints, RunLengths, read_detections
from handsight.recording.frames import Frame, Unread

CAMERA = Camera(np.array([[50.0, 0, 8], [0, 50, 6], [0, 0, 1]]), (16, 12))
MASK = np.zeros((12, 16), bool)
MASK[3:7, 5:11] = True


def counts_of(mask):
    """COCO's run lengths: column by column, the first of pixels that are not in the mask."""
    pixels = mask.T.ravel()
    ends = np.flatnonzero(np.diff(pixels)) + 1
    runs = np.diff([0, *ends, pixels.size]).tolist()
    return [0, *runs] if pixels[0] else runs


def text_of(counts):
    """`rleToString` of COCO's maskApi.c, line by line."""
    text = ""
    for i, x in enumerate(counts):
        if i > 2:
            x -= counts[i - 2]
        more = True
        while more:
            c = x & 0x1F
            x >>= 5
            more = x != -1 if c & 0x10 else x != 0
            text += chr((c | 0x20 if more else c) + 48)
    return text


@settings(max_examples=100, deadline=None)
@given(arrays(bool, (12, 16)))
def test_run_lengths_are_the_mask_they_were_made_of(mask):
    counts = counts_of(mask)
    for written in (counts, text_of(counts)):
        np.testing.assert_array_equal(RunLengths((12, 16), written).mask(CAMERA), mask)


def test_run_lengths_of_an_image_whose_numbers_are_long():
    camera = Camera(np.array([[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]), (640, 480))
    mask = np.zeros((480, 640), bool)
    mask[100:300, 200:500] = mask[5, 630:] = True
    np.testing.assert_array_equal(RunLengths((480, 640), text_of(counts_of(mask))).mask(camera), mask)


def entry(**changed):
    return {
        "scene_id": 48,
        "image_id": 1,
        "category_id": 3,
        "bbox": [5, 3, 5, 3],
        "score": 0.7,
        "time": 0.2,
    } | changed


def frame(number=(48, 1), name="000048/000001", **more):
    return Frame(name=name, camera=CAMERA, depth=np.ones((12, 16), np.float32), number=number, **more)


def written(path, content):
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return path


def hints(path, content, kind="detections", names=("cup",), numbers=None):
    known = {"cup": 3, "can": 7} if numbers is None else numbers
    return Hints(names, known, **{kind: written(path, content)})


def test_detections_are_those_of_the_object_in_the_image(tmp_path):
    rle = {"size": [12, 16], "counts": text_of(counts_of(MASK))}
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
    assert given.beside(frame((48, 4))).detections == ()
    assert given.beside(frame((48, 9))).detections == ()
    # Images of a folder have their number in their names.
    assert len(given.beside(frame(None, "img_0001_depth.png")).detections) == 2
    assert given.sentences == []
    mixed = hints(tmp_path / "b.json", [entry(), entry(category_id=99)])
    assert mixed.sentences == [f"{tmp_path}/b.json: category_id 99: no such object; left out"]
    assert len(mixed.beside(frame()).detections) == 1


def test_one_object_without_a_number_is_the_one_of_a_file_that_has_only_one(tmp_path):
    alone = hints(tmp_path / "a.json", [entry(category_id=0)], numbers={})
    assert alone.beside(frame()).detections[0].label == "cup"
    with pytest.raises(
        InvalidFile,
        match="category_id: expected one object only, as cup has no number in a library, got 0, 1",
    ):
        hints(tmp_path / "a.json", [entry(category_id=0), entry(category_id=1)], numbers={})


def test_starts_are_the_best_poses_of_each_object(tmp_path):
    rows = [f"48,1,3,{k / 20},1 0 0 0 1 0 0 0 1,{k} 0 800,-1" for k in range(15)]
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
    images = [frame(), frame((48, 2)), frame((48, 3)), Unread("x", "y")]
    assert [each.name for each in given.beside_each(images)] == ["000048/000001", "x"]


RLE = {"size": [12, 16], "counts": [192]}
WRONG = {
    "truncated": ('[{"scene_id": 48,', r"a.json: expected JSON, got other text \(Input data was truncated"),
    "an object": ("{}", "a.json: file: expected a list, got"),
    "no number": ([entry(), entry(scene_id="48")], r"a.json: \[1\].scene_id: expected a whole number, got 48 \(a text\)"),
    "no category": ([{k: v for k, v in entry().items() if k != "category_id"}], r"a.json: \[0\].category_id: expected a whole number, got nothing"),
    "not a number": ('[{"scene_id": 48, "image_id": 1, "category_id": 3, "bbox": [NaN, 1, 1, 1], "score": 1}]', "a.json: expected JSON"),
    "a box of three": ([entry(bbox=[1, 2, 3])], r"a.json: \[0\].bbox: expected 4 finite numbers"),
    "a box of less than nothing": ([entry(bbox=[5, 3, -1, 3])], r"a.json: \[0\].bbox\[2\]: expected a number of at least 0, got -1"),
    "a huge box": ([entry(bbox=[0, 0, 1e308, 1e308])], r"a.json: \[0\].bbox\[2\]: expected a number of at most 1e\+06, got 1e\+308"),
    "a score in percent": ([entry(score=97)], r"a.json: \[0\].score: expected a number of at most 1, got 97"),
    "unknown classes": ([entry(category_id=99), entry(category_id=44)], "a.json: category_id: expected one of 3, 7, got 44, 99"),
    "polygons": ([entry(segmentation=[[1, 2, 3]])], r"a.json: \[0\].segmentation: expected keys and values"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG)
def test_a_file_that_is_none_is_one_sentence(tmp_path, kind):
    content, message = WRONG[kind]
    with pytest.raises(InvalidFile, match=message) as error:
        hints(tmp_path / "a.json", content)
    assert "\n" not in str(error.value)


WRONG_IN_IMAGE = {
    "a box outside": ({"bbox": [16, 3, 5, 3]}, r"\[0\].bbox: expected a box that meets the image of 16 x 12 pixels, got \[16.0, 3.0, 5.0, 3.0\]"),
    "a mask of another image": ({"segmentation": RLE | {"size": [16, 12]}}, r"\[0\].segmentation.size: expected 12 rows, 16 columns as the image, got 16, 12"),
    "a mask of too few pixels": ({"segmentation": RLE | {"counts": [10, 20]}}, r"\[0\].segmentation.counts: expected runs of 192 pixels in all, got 30"),
    "a mask of less than nothing": ({"segmentation": RLE | {"counts": "NO2O3n0O3"}}, r"\[0\].segmentation.counts: expected runs of 192 pixels"),
    "a text that is none": ({"segmentation": RLE | {"counts": "n1~"}}, r"\[0\].segmentation.counts: expected COCO's run lengths, got '~'"),
    "a number without end": ({"segmentation": RLE | {"counts": "o" * 100}}, r"\[0\].segmentation.counts: expected COCO's run lengths"),
    "a text that was cut": ({"segmentation": RLE | {"counts": "P"}}, r"\[0\].segmentation.counts: expected COCO's run lengths, got a text that ends"),
}  # fmt: skip


@pytest.mark.parametrize("kind", WRONG_IN_IMAGE)
def test_a_detection_that_the_image_cannot_have_is_one_sentence(tmp_path, kind):
    changed, message = WRONG_IN_IMAGE[kind]
    given = hints(tmp_path / "a.json", [entry(**changed)])
    (unread,) = given.beside_each([frame()])
    assert re.match(rf"{tmp_path}/a.json: {message}", unread.reason), unread.reason


def test_images_of_a_folder_are_found_by_number_and_scene(tmp_path):
    two = hints(tmp_path / "a.json", [entry(), entry(scene_id=50)])
    with pytest.raises(
        InvalidInput, match="depth.png: expected files of one scene beside images of none, got 48, 50"
    ):
        two.beside(frame(None, "depth.png"))
    many = hints(tmp_path / "a.json", [entry(), entry(image_id=2)])
    with pytest.raises(InvalidInput, match="depth.png: expected a number in its name"):
        many.beside(frame(None, "depth.png"))
    assert len(hints(tmp_path / "a.json", [entry()]).beside(frame(None, "depth.png")).detections) == 1


@settings(max_examples=200, deadline=None)
@given(st.text(max_size=40), st.lists(st.integers(), max_size=6))
def test_run_lengths_of_any_text_are_refused_or_a_mask(text, counts):
    for written in (text, counts):
        with contextlib.suppress(InvalidInput, msgspec.ValidationError):
            lengths = msgspec.convert({"size": [12, 16], "counts": written}, RunLengths)
            assert lengths.mask(CAMERA).shape == (12, 16)


def test_read_detections_is_for_scripts_too(tmp_path):
    (one,) = read_detections(written(tmp_path / "a.json", [entry()]))
    assert (one.scene, one.image, one.object, one.score) == (48, 1, 3, 0.7)
