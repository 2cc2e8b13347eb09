import contextlib
import struct

import numpy as np
import pytest
import trimesh

from handsight.errors import InvalidFile, InvalidInput, InvalidObject
from handsight.objects import ObjectModel, ObjectWarning, read_shape
from handsight.objects.files import read as object_files
from handsight.objects.files.pcd import lzf_unpacked
from handsight.objects.files.shape import BadText
from objects.object_shapes import box_mesh

VERTICES, FACES = box_mesh((60, 90, 50))
CLOUD, NORMALS = ObjectModel.box((0.06, 0.09, 0.05)).sample(200)


def exported(kind, **options):
    data = trimesh.Trimesh(VERTICES, FACES, process=False).export(file_type=kind, **options)
    return data if isinstance(data, bytes) else data.encode()


MESHES = {
    "box.stl": exported("stl"),
    "text.stl": exported("stl_ascii"),
    "box.obj": exported("obj"),
    "box.ply": exported("ply"),
    "text.ply": exported("ply", encoding="ascii"),
    "box.off": exported("off"),
    "BOX.OFF": exported("off"),
    "quads.obj": b"# a b\xfcx\nmtllib /etc/passwd\nusemtl none\n"
    + b"".join(b"v %f %f %f\n" % tuple(v) for v in VERTICES)
    + b"f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n",
    "quads.off": b"OFF 8 6 0\n"
    + b"".join(b"%f %f %f\n" % tuple(v) for v in VERTICES)
    + b"4 0 1 3 2\n4 4 6 7 5 255 0 0\n4 0 4 5 1\n4 2 3 7 6\n4 0 2 6 4\n4 1 5 7 3\n",
}


def pcd_header(
    kind,
    n=200,
    fields="x y z rgb normal_x normal_y normal_z",
    size="4 4 4 4 4 4 4",
    types="F F F U F F F",
):
    count = " ".join("1" for _ in fields.split())
    return (
        f"# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {size}\nTYPE {types}\nCOUNT {count}\n"
        f"WIDTH {n}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {n}\nDATA {kind}\n"
    ).encode()


def pcd_rows():
    row = np.dtype([("p", "<f4", 3), ("rgb", "<u4"), ("n", "<f4", 3)])
    rows = np.zeros(len(CLOUD), dtype=row)
    rows["p"], rows["n"], rows["rgb"] = CLOUD, NORMALS, 0xFF8800
    return rows


def lzf_packed(data):
    """LZF with both of its elements: literal runs, and back references for runs of one byte."""
    out, at = bytearray(), 0
    while at < len(data):
        run = 1
        while at + run < len(data) and data[at + run] == data[at] and run < 264:
            run += 1
        if run >= 4:
            out += bytes([0, data[at]])
            length = run - 1 - 2
            out += bytes([length << 5]) if length < 7 else bytes([7 << 5, length - 7])
            out += bytes([0])
            at += run
        else:
            out += bytes([0, data[at]])
            at += 1
    return bytes(out)


def pcd_compressed():
    rows = pcd_rows()
    columns = [rows["p"][:, k] for k in range(3)] + [rows["rgb"]] + [rows["n"][:, k] for k in range(3)]
    flat = b"".join(np.ascontiguousarray(c).tobytes() for c in columns)
    packed = lzf_packed(flat)
    return pcd_header("binary_compressed") + struct.pack("<II", len(packed), len(flat)) + packed


def rows_of_text(*columns, separator=" "):
    return "\n".join(separator.join(f"{v:.9g}" for v in row) for row in np.hstack(columns)).encode()


PLY_CLOUD = (
    f"ply\nformat ascii 1.0\nelement vertex {len(CLOUD)}\n".encode()
    + b"".join(b"property float %s\n" % n for n in (b"x", b"y", b"z", b"nx", b"ny", b"nz"))
    + b"end_header\n" + rows_of_text(CLOUD, NORMALS) + b"\n"
)  # fmt: skip
TEXT_PCD = pcd_header("ascii") + rows_of_text(CLOUD, np.full((len(CLOUD), 1), 7.0), NORMALS)
CLOUDS = {
    "cloud.ply": PLY_CLOUD,
    "cloud.off": f"NOFF\n{len(CLOUD)} 0 0\n".encode() + rows_of_text(CLOUD, NORMALS),
    "cloud.xyz": b"# x y z nx ny nz\n" + rows_of_text(CLOUD, NORMALS),
    "comma.xyz": rows_of_text(CLOUD, NORMALS, separator=", "),
    "text.pcd": TEXT_PCD,
    "binary.pcd": pcd_header("binary") + pcd_rows().tobytes(),
    "packed.pcd": pcd_compressed(),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_read_from_every_format(tmp_path, name):
    (tmp_path / name).write_bytes(MESHES[name])
    model = ObjectModel.from_file(tmp_path / name, scale=0.001)
    assert model.name == name.split(".")[0]
    assert len(model.faces) == 12
    np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), [0.06, 0.09, 0.05], atol=1e-7)
    assert model.closed
    assert model.remarks == ()


@pytest.mark.parametrize("name", CLOUDS)
def test_a_cloud_is_read_from_every_format(tmp_path, name):
    (tmp_path / name).write_bytes(CLOUDS[name])
    shape = read_shape(tmp_path / name)
    assert shape.faces is None
    np.testing.assert_allclose(shape.vertices, CLOUD, atol=1e-7)
    np.testing.assert_allclose(shape.normals, NORMALS, atol=1e-6)


def test_a_cloud_without_normals_is_read(tmp_path):
    (tmp_path / "a.xyz").write_bytes(rows_of_text(CLOUD))
    assert read_shape(tmp_path / "a.xyz").normals is None
    (tmp_path / "a.pcd").write_bytes(
        pcd_header("ascii", fields="x y z", size="8 8 8", types="F F F") + rows_of_text(CLOUD)
    )
    assert read_shape(tmp_path / "a.pcd").normals is None
    assert len(ObjectModel.from_file(tmp_path / "a.xyz").vertices) == len(CLOUD)


def test_missing_points_of_a_sensor_are_dropped_and_counted(tmp_path):
    points = CLOUD.copy()
    points[:3] = np.nan
    (tmp_path / "a.xyz").write_bytes(rows_of_text(points, NORMALS))
    with pytest.warns(
        ObjectWarning, match=r"a.xyz: 3 points that are not finite, or have no normal, were dropped"
    ):
        assert len(ObjectModel.from_file(tmp_path / "a.xyz").vertices) == len(CLOUD) - 3


def test_a_path_may_be_a_string(tmp_path):
    (tmp_path / "b.off").write_bytes(MESHES["box.off"])
    assert ObjectModel.from_file(str(tmp_path / "b.off"), 0.001).name == "b"


def test_a_wrong_scale_is_named(tmp_path):
    with pytest.raises(InvalidInput, match="scale: expected a number above 0, got 0"):
        ObjectModel.from_file(tmp_path / "b.off", scale=0)


def test_a_mesh_in_millimetres_warns_with_the_scale(tmp_path):
    (tmp_path / "b.off").write_bytes(MESHES["box.off"])
    with pytest.warns(ObjectWarning, match="largest extent 90 m: looks like millimetres; try scale=0.001"):
        ObjectModel.from_file(tmp_path / "b.off")


HUGE = str(10**15).encode()
BROKEN = {
    "empty.stl": (b"", "the file is empty"),
    "cut.stl": (MESHES["box.stl"][:400], "is it cut short"),
    "short.stl": (MESHES["box.stl"][:50], "is it cut short"),
    "cuttext.stl": (MESHES["text.stl"][:600], "expected 'endsolid' at the end"),
    "huge.stl": (MESHES["box.stl"][:80] + b"\xff\xff\xff\xff" + MESHES["box.stl"][84:], "is it cut short"),
    "text.stl": (b"hello", "is it cut short"),
    "none.obj": (b"v 0 0 0\nv 1 0 0\n", "expected triangles, got none"),
    "words.obj": (b"hello", "expected triangles, got none"),
    "bytes.obj": (bytes(range(256)) * 4, ""),
    "beyond.obj": (b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n", "faces: expected vertices 1 to 3, got 9"),
    "cut.ply": (MESHES["box.ply"][:-40], ""),
    "cuttext.ply": (PLY_CLOUD[:-400], ""),
    "huge.ply": (PLY_CLOUD.replace(b"vertex 200", b"vertex " + HUGE), ""),
    "header.ply": (b"ply\n", ""),
    "other.ply": (b"hello", ""),
    "columns.ply": (PLY_CLOUD.replace(b"float z", b"float w"), ""),
    "other.off": (b"hello", "expected OFF, NOFF, COFF or CNOFF, got 'HELLO'"),
    "counts.off": (b"OFF\n", "expected the counts"),
    "huge.off": (MESHES["box.off"].replace(b"8 12", HUGE + b" 12"), "vertices and 12 faces, got"),
    "cut.off": (MESHES["box.off"].rstrip().rpartition(b"\n")[0], "expected 8 vertices and 12 faces, got 19 rows"),
    "word.off": (MESHES["quads.off"].replace(b"4 0 1 3 2", b"4 0 x 3 2"), "face 0: expected whole numbers"),
    "corners.off": (MESHES["quads.off"].replace(b"4 0 1 3 2", b"9 0 1 3 2"), "face 0: expected at least 3 corners"),
    "ragged.xyz": (b"1 2 3\n1 2\n", "row 2: expected 3 columns, got 2"),
    "four.xyz": (b"1 2 3 4\n", "expected 3 or 6 columns, got 4"),
    "words.xyz": (b"a b c\n", "expected numbers"),
    "comment.xyz": (b"# nothing\n", "expected rows of numbers, got none"),
    "header.pcd": (b"VERSION 0.7\n", "expected a PCD header that ends with DATA"),
    "kind.pcd": (pcd_header("zipped"), "DATA: expected ascii, binary or binary_compressed, got 'zipped'"),
    "cut.pcd": (CLOUDS["binary.pcd"][:-1], "bytes of points, got"),
    "cuttext.pcd": (TEXT_PCD[:-200], "expected 200 points of 7 numbers"),
    "huge.pcd": (pcd_header("binary", n=10**15) + b"0" * 100, "bytes of points, got 100"),
    "hugetext.pcd": (pcd_header("ascii", n=10**15) + b"0 0 0", "points of 7 numbers, got 3 numbers"),
    "negative.pcd": (pcd_header("binary", n=-5), "expected 1 whole numbers, got '-5'"),
    "types.pcd": (pcd_header("binary", types="F F F U F F Q"), "TYPE and SIZE: expected F, I or U"),
    "sizes.pcd": (pcd_header("binary", size="4 4 4 4 4 4 3"), "TYPE and SIZE"),
    "fields.pcd": (pcd_header("binary", n=0, fields="a b c d e f g"), "expected the fields x y z, got a b c"),
    "packed.pcd": (CLOUDS["packed.pcd"][:-9], "compressed bytes, got"),
    "bomb.pcd": (pcd_header("binary_compressed", n=10**8) + struct.pack("<II", 10, 28 * 10**8) + b"0" * 10, "bytes unpacked"),
    "sizes2.pcd": (pcd_header("binary_compressed") + b"123", "expected two sizes"),
    "none.pcd": (pcd_header("ascii", n=0), "expected points or triangles, got none"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_by_name(tmp_path, name):
    data, message = BROKEN[name]
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InvalidFile) as caught:
        ObjectModel.from_file(tmp_path / name)
    assert str(caught.value).startswith(f"{name}: ")
    assert message in str(caught.value)


@pytest.mark.parametrize("name", [*MESHES, *CLOUDS])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_a_file_cut_anywhere_is_refused_or_read_with_no_more_points(tmp_path, name, part):
    data = {**MESHES, **CLOUDS}[name]
    (tmp_path / name).write_bytes(data[: int(part * len(data))])
    if name.endswith((".xyz", ".obj")):  # formats without counts cannot know
        with contextlib.suppress(InvalidFile):
            assert len(read_shape(tmp_path / name).vertices) <= len(CLOUD)
        return
    with pytest.raises(InvalidFile, match=f"^{name}: "):
        read_shape(tmp_path / name)


def test_a_path_without_a_readable_file_is_refused_by_name(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    for name, message in (
        ("absent.stl", "cannot be read: No such file or directory"),
        ("folder.stl", "expected a file, got a folder"),
        ("box.step", r"expected one of .obj, .off, .pcd, .ply, .stl, .xyz, got .step"),
        ("box", "got no extension"),
    ):
        with pytest.raises(InvalidFile, match=rf"^{name}: .*{message}"):
            ObjectModel.from_file(tmp_path / name)


def test_a_file_larger_than_any_object_is_refused(tmp_path, monkeypatch):
    (tmp_path / "b.off").write_bytes(MESHES["box.off"])
    monkeypatch.setattr(object_files, "LARGEST_FILE", 100)
    with pytest.raises(InvalidFile, match="b.off: expected at most"):
        ObjectModel.from_file(tmp_path / "b.off")


def test_a_mesh_under_a_wrong_extension_is_refused(tmp_path):
    for name, kind in (
        ("a.stl", "box.ply"),
        ("a.ply", "box.stl"),
        ("a.off", "box.obj"),
        ("a.pcd", "box.off"),
    ):
        (tmp_path / name).write_bytes(MESHES[kind])
        with pytest.raises(InvalidFile, match=f"^{name}: "):
            ObjectModel.from_file(tmp_path / name)


def test_the_message_for_a_file_without_a_surface_begins_with_its_name(tmp_path):
    (tmp_path / "flat.off").write_bytes(b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n")
    with pytest.raises(
        InvalidObject, match=r"^flat.off: faces: expected triangles with an area, got 1 without"
    ):
        ObjectModel.from_file(tmp_path / "flat.off")
    (tmp_path / "few.xyz").write_bytes(b"0 0 0\n1 0 0\n0 1 0\n")
    with pytest.raises(InvalidObject, match=r"^few.xyz: points: expected at least 20 points, got 3"):
        ObjectModel.from_file(tmp_path / "few.xyz")


def test_unpacking_follows_the_format():
    assert lzf_unpacked(bytes([2]) + b"abc", 3) == b"abc"
    assert lzf_unpacked(bytes([0]) + b"a" + bytes([1 << 5, 0]), 4) == b"aaaa"
    assert lzf_unpacked(bytes([1]) + b"ab" + bytes([7 << 5, 1, 1]), 12) == b"ab" * 6
    for packed in (b"\x05a", bytes([0x20]), bytes([0xE0, 1]), bytes([0, 97, 1 << 5, 9]), bytes([0, 97])):
        with pytest.raises(BadText, match="compressed|unpacked"):
            lzf_unpacked(packed, 4)
