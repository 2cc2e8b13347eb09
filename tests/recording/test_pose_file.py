"""A pose is the same in the files of every estimator, in metres; what is none is refused with its line or entry."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from handsight import se3
from handsight.errors import InvalidFile
from handsight.recording.pose_file import BOP_COLUMNS, read_poses
from testbed.refusals import refused

POSES = se3.random(np.random.default_rng(3), 3)
POSES[:, 2, 3] += 2.0


def text(numbers):
    return " ".join(repr(float(x)) for x in np.ravel(numbers))


def bop(T, image):
    return f"48,{image},5,0.75,{text(T[:3, :3])},{text(1e3 * T[:3, 3])},0.1"


def sam6d(T, image):
    entry = {"scene_id": 48, "image_id": image, "category_id": 5, "bbox": [1, 2, 3, 4], "score": 0.75}
    return entry | {"R": T[:3, :3].tolist(), "t": (1e3 * T[:3, 3]).tolist()}


def megapose(T):
    quaternion, position = se3.quaternion_from_rotation(T[:3, :3]), T[:3, 3]
    return {"label": "mug", "TWO": [quaternion.tolist(), position.tolist()]}


def written(folder, kind):
    """A file or a folder of the three poses."""
    if kind == "bop.csv":
        lines = [BOP_COLUMNS, *(bop(T, i) for i, T in enumerate(POSES))]
        (folder / kind).write_text("\n".join(lines))
    elif kind == "sam6d.json":
        (folder / kind).write_text(json.dumps([sam6d(T, i) for i, T in enumerate(POSES)]))
    elif kind == "megapose.json":
        (folder / kind).write_text(json.dumps([megapose(T) for T in POSES]))
    else:
        (folder / kind).mkdir()
        for i, T in enumerate(POSES):
            np.savetxt(folder / kind / f"{i}.txt", T) if kind == "ob_in_cam" else np.save(
                folder / kind / f"{i}.npy", T
            )
    return folder / kind


@pytest.mark.parametrize("kind", ["bop.csv", "sam6d.json", "megapose.json", "ob_in_cam", "arrays"])
def test_a_pose_is_the_same_in_every_file(tmp_path, kind):
    found = read_poses(written(tmp_path, kind))
    np.testing.assert_allclose([each.T_camera_object for each in found], POSES, atol=1e-12)
    numbered = kind != "megapose.json"
    assert [each.image for each in found] == (["0", "1", "2"] if numbered else [""] * 3)
    names = {"bop.csv": "5", "sam6d.json": "5", "megapose.json": "mug"}
    assert {each.object for each in found} == {names.get(kind, "")}
    assert {each.scene for each in found} == {48 if kind in ("bop.csv", "sam6d.json") else None}


@given(values=st.lists(st.floats(width=64), min_size=16, max_size=16))
def test_any_sixteen_numbers_are_a_pose_or_refused(tmp_path_factory, values):
    path = tmp_path_factory.mktemp("pose") / "one.txt"
    path.write_text(text(values))
    try:
        (found,) = read_poses(path)
    except InvalidFile:
        return
    se3.check(found.T_camera_object, "pose")


@pytest.mark.parametrize(
    ("name", "content", "field"),
    [
        ("a.csv", "1,2,3\n", "line 1"),
        ("a.csv", f"{BOP_COLUMNS}\n{bop(2 * POSES[0], 0)}", "line 2"),
        ("a.csv", b"\xff\xfe", "a.csv"),
        ("a.json", "{}", "a.json"),
        ("a.json", "[" * 100_000, "a.json"),
        ("a.json", json.dumps([sam6d(POSES[0], 0), {"scene_id": 1}]), "[1]"),
        ("a.json", json.dumps([sam6d(POSES[0], 0) | {"t": [1, 2]}]), "[0]"),
        ("a.json", json.dumps([megapose(POSES[0]) | {"TWO": [[0, 0, 0, 0], [0, 0, 1]]}]), "[0]"),
        ("a.txt", "1 0 0", "a.txt"),
        ("a.txt", "one", "a.txt"),
        ("a.npy", b"\x93NUMPY\x01\x00v\x00", "a.npy"),
        ("a.npy", b"\x93NUMPY\x01\x00v\x00{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999,), }" + b" " * 40 + b"\n", "a.npy"),
    ],
)  # fmt: skip
def test_what_is_no_pose_is_refused_where_it_stands(tmp_path, name, content, field):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with refused(InvalidFile, field):
        read_poses(path)


def test_a_file_from_a_spreadsheet_without_a_header_is_read(tmp_path):
    path = tmp_path / "a.csv"
    path.write_bytes(b"\xef\xbb\xbf" + bop(POSES[0], 4).encode() + b"\r\n\r\n")
    (found,) = read_poses(path)
    assert (found.image, found.score) == ("4", 0.75)
    np.testing.assert_allclose(found.T_camera_object, POSES[0], atol=1e-12)


@pytest.mark.parametrize(
    "line",
    [
        "48,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 800",
        "four,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 800,1",
        "48,1,5,nan,1 0 0 0 1 0 0 0 1,10 -20 800,1",
        "48,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 1e99,1",
        "48,1,5,0.93,1 0 0 0 x 0 0 0 1,10 -20 800,1",
        "48,1,5,0.93,1 0 0 0 1 0 0 0 -1,10 -20 800,1",
        "48,1,5,0.93,1e200 0 0 0 1 0 0 0 1,10 -20 800,1",
        '48,1,5,0.93,1 0 0 0 1 0 0 0 1,10 -20 800,1,"',
    ],
)
def test_an_error_of_bop_s_results_names_its_line(tmp_path, line):
    path = tmp_path / "a.csv"
    path.write_text(f"{BOP_COLUMNS}\n{bop(POSES[0], 4)}\n{line}")
    with refused(InvalidFile, "line 3"):
        read_poses(path)


def test_a_folder_without_poses_is_refused(tmp_path):
    with refused(InvalidFile, tmp_path.name):
        read_poses(tmp_path)
