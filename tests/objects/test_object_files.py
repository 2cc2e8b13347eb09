"""Laws of files of objects: every format gives the same object, no file is read in part, and none opens another."""

import contextlib
import io
import json
import subprocess
import sys
import zipfile

import numpy as np
import pytest
import trimesh

from handsight.errors import InvalidFile, InvalidInput, InvalidObject, MissingExtra
from handsight.objects import ObjectModel, ObjectWarning, read_shape
from objects.object_shapes import box_mesh

SIZE = np.array([0.06, 0.09, 0.05])
VERTICES, FACES = box_mesh(1000 * SIZE)
CLOUD, NORMALS = ObjectModel.box(SIZE).sample(200)
SIDES = b"f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"
EXTRAS = {".dae": "collada", ".3mf": "networkx"}


def exported(kind, scale=1.0, **options):
    data = trimesh.Trimesh(scale * VERTICES, FACES, process=False).export(file_type=kind, **options)
    return data if isinstance(data, bytes) else data.encode()


def rows_of(table, before=b""):
    return b"".join(before + b" ".join(b"%.9g" % value for value in row) + b"\n" for row in table)


def needs_extra(name):
    for ending, module in EXTRAS.items():
        if name.endswith(ending):
            pytest.importorskip(module, reason="DAE and 3MF need pip install 'handsight[meshes]'")


def saved(folder, name, data):
    path = folder / name
    path.write_bytes(data)
    return path


MESHES = {
    "box.stl": exported("stl"),
    "text.stl": exported("stl_ascii"),
    "box.obj": exported("obj"),
    "quads.obj": b"# a b\xfcx\nmtllib /etc/passwd\nusemtl none\n" + rows_of(VERTICES, b"v ") + SIDES,
    "slashes.obj": rows_of(VERTICES, b"v ") + b"vt 0 0\n" + SIDES.replace(b" 4", b" 4/1/1"),
    "backwards.obj": rows_of(VERTICES, b"v ") + SIDES[:40].replace(b"f 1 2 4 3", b"f -8 -7 -5 -6") + SIDES[40:]
    + rows_of(VERTICES[:1], b"v "),
    "box.ply": exported("ply"),
    "text.ply": exported("ply", encoding="ascii"),
    "box.off": exported("off"),
    "BOX.OFF": exported("off"),
    "modelnet.off": exported("off").replace(b"OFF\n", b"OFF"),
    "quads.off": b"OFF 8 6 0\n" + rows_of(VERTICES)
    + b"4 0 1 3 2\n4 4 6 7 5 255 0 0\n4 0 4 5 1\n4 2 3 7 6\n4 0 2 6 4\n4 1 5 7 3\n",
}  # fmt: skip
IN_METRES = {name: exported(name[4:], 0.001) for name in ("box.glb",)}
PLY_HEADER = f"ply\nformat ascii 1.0\nelement vertex {len(CLOUD)}\n".encode() + b"".join(
    b"property double %s\n" % name for name in (b"x", b"y", b"z", b"nx", b"ny", b"nz")
)
CLOUDS = {
    "cloud.ply": PLY_HEADER + b"end_header\n" + rows_of(np.hstack([CLOUD, NORMALS])),
    "cloud.off": f"NOFF\n{len(CLOUD)} 0 0\n".encode() + rows_of(np.hstack([CLOUD, NORMALS])),
    "cloud.xyz": b"# x y z nx ny nz\n" + rows_of(np.hstack([CLOUD, NORMALS])),
    "comma.xyz": rows_of(np.hstack([CLOUD, NORMALS])).replace(b" ", b", "),
}


@pytest.mark.parametrize("name", MESHES)
def test_a_mesh_is_read_from_every_format(tmp_path, name):
    model = ObjectModel.from_file(saved(tmp_path, name, MESHES[name]), scale=0.001)
    assert model.name == name.split(".")[0]
    assert len(model.faces) == 12
    np.testing.assert_allclose(np.ptp(model.bounds_object, axis=0), SIZE, atol=1e-7)
    assert model.closed
    assert model.remarks == ()


@pytest.mark.parametrize("name", CLOUDS)
def test_a_cloud_is_read_from_every_format(tmp_path, name):
    shape = read_shape(saved(tmp_path, name, CLOUDS[name]))
    assert shape.faces is None
    np.testing.assert_allclose(shape.vertices, CLOUD, atol=1e-7)
    np.testing.assert_allclose(shape.normals, NORMALS, atol=1e-6)


def test_a_cloud_without_normals_is_read(tmp_path):
    path = saved(tmp_path, "a.xyz", rows_of(CLOUD))
    assert read_shape(path).normals is None
    assert len(ObjectModel.from_file(path).vertices) == len(CLOUD)


@pytest.mark.parametrize("kind", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_cloud_keeps_the_sigma_that_it_declares_for_each_point(tmp_path, kind):
    sigmas = np.linspace(1e-3, 2e-3, len(CLOUD))
    table = np.column_stack([CLOUD, NORMALS, sigmas])
    header = PLY_HEADER.replace(b"ascii", kind.encode()) + b"property double sigma\nend_header\n"
    order = "<" if "little" in kind else ">"
    body = rows_of(table) if kind == "ascii" else table.astype(f"{order}f8").tobytes()
    shape = read_shape(saved(tmp_path, "a.ply", header + body))
    np.testing.assert_allclose(shape.sigmas, sigmas, rtol=1e-8)
    model = ObjectModel.from_file(tmp_path / "a.ply")
    plain = ObjectModel.from_file(saved(tmp_path, "plain.ply", CLOUDS["cloud.ply"]))
    added = model.field_error.values[..., 0] - plain.field_error.values[..., 0]
    assert (added > 0.9e-6).all()
    assert (added < 4.1e-6).all()


def turned_box(kind, unit=1.0):
    """The content of a scene whose node turns a box by a quarter about z, mirrors it, and moves it by 0.1 m along x."""
    scene = trimesh.Scene()
    T = np.array([[0.0, 1, 0, 0.1 / unit], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]])
    scene.add_geometry(trimesh.creation.box(SIZE / unit), transform=T)
    return scene.export(file_type=kind)


def check_turned_box(path):
    model = ObjectModel.from_file(path)
    np.testing.assert_allclose(model.bounds_object[0], [0.1 - 0.045, -0.03, -0.025], atol=1e-7)
    np.testing.assert_allclose(model.bounds_object[1], [0.1 + 0.045, 0.03, 0.025], atol=1e-7)
    assert model.closed
    assert model.remarks == ()


def test_the_nodes_of_a_glb_place_its_meshes(tmp_path):
    check_turned_box(saved(tmp_path, "a.glb", turned_box("glb")))


def test_a_3mf_is_in_the_unit_that_it_states(tmp_path):
    needs_extra("a.3mf")
    check_turned_box(saved(tmp_path, "a.3mf", turned_box("3mf", unit=0.001)))


def test_a_dae_is_in_the_unit_that_it_states_and_its_nodes_place_its_meshes(tmp_path):
    needs_extra("a.dae")
    data = trimesh.creation.box(SIZE / 0.01).export(file_type="dae")
    data = data.replace(b"<up_axis>", b'<unit name="centimeter" meter="0.01"/><up_axis>')
    data = data.replace(
        b"<instance_geometry", b"<matrix>0 1 0 10 1 0 0 0 0 0 1 0 0 0 0 1</matrix><instance_geometry"
    )
    check_turned_box(saved(tmp_path, "a.dae", data))


CORE = """
import sys, warnings
for name in ("collada", "lxml", "networkx", "PIL", "shapely", "pooch", "mujoco"):
    sys.modules[name] = None
from handsight.objects import read_shape
for path in sys.argv[1:]:
    print(len(read_shape(path).vertices))
"""


def test_core_formats_need_no_extra(tmp_path):
    files = {name: data for name, data in {**MESHES, **CLOUDS, **IN_METRES}.items() if name != "BOX.OFF"}
    paths = [str(saved(tmp_path, name, data)) for name, data in files.items()]
    subprocess.run([sys.executable, "-c", CORE, *paths], check=True, capture_output=True)


@pytest.mark.parametrize("ending", EXTRAS)
def test_a_format_whose_extra_is_missing_names_it(tmp_path, monkeypatch, ending):
    monkeypatch.setitem(sys.modules, EXTRAS[ending], None)
    with pytest.raises(MissingExtra) as caught:
        ObjectModel.from_file(saved(tmp_path, f"a{ending}", b"anything"))
    assert "handsight[meshes]" in str(caught.value)


def test_missing_points_of_a_sensor_are_dropped_and_counted(tmp_path):
    points = CLOUD.copy()
    points[:3] = np.nan
    path = saved(tmp_path, "a.xyz", rows_of(np.hstack([points, NORMALS])))
    with pytest.warns(ObjectWarning):
        assert len(ObjectModel.from_file(path).vertices) == len(CLOUD) - 3


def test_a_path_may_be_a_string(tmp_path):
    path = saved(tmp_path, "b.off", MESHES["box.off"])
    assert ObjectModel.from_file(str(path), 0.001).name == "b"


def test_a_wrong_scale_is_refused(tmp_path):
    with pytest.raises(InvalidInput):
        ObjectModel.from_file(tmp_path / "b.off", scale=0)


def test_a_mesh_in_millimetres_warns(tmp_path):
    with pytest.warns(ObjectWarning):
        ObjectModel.from_file(saved(tmp_path, "b.off", MESHES["box.off"]))


def glb_of(header, rest=b""):
    text = json.dumps(header).encode()
    size = len(text).to_bytes(4, "little")
    return (
        b"glTF\x02\0\0\0" + (20 + len(text) + len(rest)).to_bytes(4, "little") + size + b"JSON" + text + rest
    )


HUGE = 10**15
ACCESSORS = [{"count": HUGE, "componentType": 5126, "type": "VEC3"}]
TRIANGLE = {
    "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}], "nodes": [{"mesh": 0}],
    "meshes": [{"primitives": [{"attributes": {"POSITION": 0}}]}], "bufferViews": [{"buffer": 0, "byteLength": 36}],
    "accessors": [{"bufferView": 0, "count": 3, "componentType": 5126, "type": "VEC3"}],
    "buffers": [{"byteLength": 36, "uri": "secret.bin"}],
}  # fmt: skip
BROKEN = {
    "empty.stl": b"",
    "huge.stl": MESHES["box.stl"][:80] + b"\xff\xff\xff\xff" + MESHES["box.stl"][84:],
    "text.stl": b"hello",
    "none.obj": b"v 0 0 0\nv 1 0 0\n",
    "words.obj": b"hello",
    "bytes.obj": bytes(range(256)) * 4,
    "beyond.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n",
    "zero.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 0\n",
    "before.obj": b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 -4\n",
    "word.obj": b"v 0 0 0\nv 1 x 0\nv 0 1 0\nf 1 2 3\n",
    "huge.ply": CLOUDS["cloud.ply"].replace(b"vertex 200", b"vertex %d" % HUGE),
    "digits.ply": CLOUDS["cloud.ply"].replace(b"vertex 200", b"vertex 1" + b"0" * 17),
    "less.ply": CLOUDS["cloud.ply"].replace(b"vertex 200", b"vertex -5"),
    "word.ply": CLOUDS["cloud.ply"][:-20] + b"x" + CLOUDS["cloud.ply"][-19:],
    "header.ply": b"ply\n",
    "other.ply": b"hello",
    "columns.ply": CLOUDS["cloud.ply"].replace(b"double z", b"double w"),
    "other.off": b"hello",
    "counts.off": b"OFF\n",
    "huge.off": MESHES["box.off"].replace(b"8 12", b"%d 12" % HUGE),
    "word.off": MESHES["quads.off"].replace(b"4 0 1 3 2", b"4 0 x 3 2"),
    "beyond.off": MESHES["quads.off"].replace(b"4 0 1 3 2", b"4 0 8 3 2"),
    "corners.off": MESHES["quads.off"].replace(b"4 0 1 3 2", b"9 0 1 3 2"),
    "ragged.xyz": b"1 2 3\n1 2\n",
    "four.xyz": b"1 2 3 4\n",
    "long.xyz": b"0" * 2_200_000,
    "words.xyz": b"a b c\n",
    "comment.xyz": b"# nothing\n",
    "huge.glb": glb_of(TRIANGLE | {"accessors": ACCESSORS}),
    "circle.glb": glb_of(TRIANGLE | {"nodes": [{"children": [0, 0], "mesh": 0}]}),
    "other.glb": glb_of(TRIANGLE),
    "words.glb": b"hello",
}


@pytest.mark.filterwarnings("ignore:.*input contained no data")
@pytest.mark.parametrize("name", BROKEN)
def test_a_broken_file_is_refused_by_name(tmp_path, name):
    with pytest.raises(InvalidFile) as caught:
        ObjectModel.from_file(saved(tmp_path, name, BROKEN[name]))
    assert str(caught.value).startswith(f"{name}: ")


@pytest.mark.parametrize("name", [*MESHES, *CLOUDS, *IN_METRES])
@pytest.mark.parametrize("part", [0.1, 0.5, 0.9, 0.97])
def test_a_file_cut_anywhere_is_refused_or_read_with_no_more_points(tmp_path, name, part):
    data = {**MESHES, **CLOUDS, **IN_METRES}[name]
    path = saved(tmp_path, name, data[: int(part * len(data))])
    if name.endswith((".xyz", ".obj")):  # formats without counts cannot know
        with contextlib.suppress(InvalidFile):
            assert len(read_shape(path).vertices) <= len(CLOUD)
        return
    with pytest.raises(InvalidFile):
        read_shape(path)


@pytest.mark.parametrize("polygon", ["3 0 1 2", "4 0 1 3 2", "5 0 1 3 7 6"])
@pytest.mark.parametrize("kind", ["off", "ply"])
def test_a_last_polygon_that_lost_a_corner_is_refused(tmp_path, kind, polygon):
    header = (
        b"ply\nformat ascii 1.0\nelement vertex 8\nproperty float x\nproperty float y\nproperty float z\n"
    )
    header += b"element face 2\nproperty list uchar int vertex_indices\nend_header\n"
    header = header if kind == "ply" else b"OFF\n8 2 0\n"
    whole = header + rows_of(VERTICES) + b"3 4 5 6\n" + polygon.encode()
    assert len(read_shape(saved(tmp_path, f"a.{kind}", whole)).faces) == int(polygon[0]) - 1
    with pytest.raises(InvalidFile):
        read_shape(saved(tmp_path, f"a.{kind}", whole[:-2]))


def test_no_file_is_opened_beside_the_one_that_is_named(tmp_path):
    """A buffer beside a GLB, a library of materials, a texture and an entity would each be read."""
    saved(tmp_path, "secret.bin", np.eye(3, dtype="<f4").tobytes())
    with pytest.raises(InvalidFile):
        read_shape(saved(tmp_path, "a.glb", glb_of(TRIANGLE)))
    needs_extra("a.dae")
    entity = b'<!DOCTYPE COLLADA [<!ENTITY e SYSTEM "secret.bin">]>'
    data = trimesh.creation.box(SIZE).export(file_type="dae")
    for encoded in (entity + data, (entity + data).decode().encode("utf-16")):
        with pytest.raises(InvalidFile):
            read_shape(saved(tmp_path, "a.dae", encoded))


def test_an_archive_that_would_not_fit_into_memory_is_refused(tmp_path):
    needs_extra("a.3mf")
    stream = io.BytesIO()
    with (
        zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive,
        archive.open("3D/3dmodel.model", "w") as file,
    ):
        for _ in range(501):
            file.write(bytes(1_000_000))
    with pytest.raises(InvalidFile):
        read_shape(saved(tmp_path, "a.3mf", stream.getvalue()))


def test_a_path_without_a_readable_file_is_refused_by_name(tmp_path):
    (tmp_path / "folder.stl").mkdir()
    for name in ("absent.stl", "folder.stl", "box.step", "box"):
        with pytest.raises(InvalidFile) as caught:
            ObjectModel.from_file(tmp_path / name)
        assert str(caught.value).startswith(f"{name}: ")


def test_a_mesh_under_a_wrong_extension_is_refused(tmp_path):
    for name, kind in (
        ("a.stl", "box.ply"),
        ("a.ply", "box.stl"),
        ("a.off", "box.obj"),
        ("a.glb", "box.off"),
    ):
        with pytest.raises(InvalidFile):
            ObjectModel.from_file(saved(tmp_path, name, MESHES[kind]))


def test_the_message_for_a_file_without_a_surface_begins_with_its_name(tmp_path):
    flat = b"OFF\n3 1 0\n0 0 0\n1 0 0\n2 0 0\n3 0 1 2\n"
    quads = MESHES["quads.obj"]
    for name, data in (
        ("flat.off", flat),
        ("few.xyz", b"0 0 0\n1 0 0\n0 1 0\n"),
        ("nan.obj", quads.replace(b"-30", b"nan")),
        ("far.obj", quads.replace(b"-30", b"1e300", 1)),
    ):
        with pytest.raises(InvalidObject) as caught:
            ObjectModel.from_file(saved(tmp_path, name, data))
        assert str(caught.value).startswith(f"{name}: ")
