"""Layouts of taxels in a rig: by grid, table, file, URDF sensor or product; wrong ones are refused in one sentence."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from handsight import se3
from handsight.errors import InvalidFile
from handsight.rig import Rig
from handsight.rig.save import text
from rig.rigs import full
from testbed.refusals import refused

BALL = np.array([[0.006 * np.sin(a) * np.cos(b), 0.006 * np.sin(a) * np.sin(b), 0.006 * np.cos(a)]
                 for a in (0.4, 0.9) for b in np.arange(0, 2 * np.pi, np.pi / 3)])  # fmt: skip
ROWS = np.column_stack([BALL, BALL / 0.006])
URDF = """<robot name="hand">
  <link name="palm"/><link name="index_tip"/><link name="thumb_tip"/>
  <joint name="a" type="revolute"><parent link="palm"/><child link="index_tip"/><axis xyz="0 0 1"/>
    <origin xyz="0.05 0 0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <joint name="b" type="revolute"><parent link="palm"/><child link="thumb_tip"/><axis xyz="0 1 0"/>
    <origin xyz="-0.05 0 0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  <sensor name="pad"><parent link="index_tip"/><origin xyz="0 0 0.034" rpy="0 1.5707963267948966 0"/>
    <tactile><array rows="2" cols="3" order="ORDER" size="0.005 0.004" offset="0.001 0"/></tactile></sensor>
  <sensor name="list"><parent link="palm"/><tactile>
    <taxel idx="1" xyz="0.01 0.004 0" rpy="0 0 0"/><taxel idx="0" xyz="0.01 0 0" rpy="0 0.3 0"/></tactile></sensor>
</robot>"""


@pytest.fixture
def rig_with(tmp_path):
    """`rig_with(lines)`: the rig of a file with these lines for a surface `skin.a`."""
    pytest.importorskip("mujoco")

    def read(lines, urdf=None):
        rig = full(tmp_path, 0, (0.1, 0.1, 0.1), None)
        content = text(replace(rig, skin={}, topics=replace(rig.topics, skin={})))
        if urdf is not None:
            (tmp_path / "sensors.urdf").write_text(urdf)
            content = content.replace(rig.hand.file, str(tmp_path / "sensors.urdf"))
            name = content.split("file: ")[1].split("\n")[0].split("   ")[0]
            content = content.replace(name, json.dumps(str(tmp_path / "sensors.urdf")), 1)
        path = tmp_path / "rig.yaml"
        path.write_text(content + "skin:\n  a: {" + lines + ", threshold: 0.1}\n")
        return Rig.from_file(path)

    return read


MILLIMETRES = (ROWS * [1e3, 1e3, 1e3, 1, 1, 1]).tolist()
COLUMNS = [f"{each}" for each in ("x", "y", "z", "nx", "ny", "nz")]
MAKERS = {
    "names.csv": "taxel;Z (mm);Y (mm);X (mm);nx;ny;nz\n"
    + "".join(f"T{k};{r[2]};{r[1]};{r[0]};{r[3]};{r[4]};{r[5]}\n" for k, r in enumerate(MILLIMETRES)),
    "numbered.csv": "".join(",".join(map(str, [k, *row])) + "\n" for k, row in enumerate(ROWS.tolist())),
    "named.csv": "".join(",".join([f"T{k}", *map(str, row)]) + "\n" for k, row in enumerate(ROWS.tolist())),
    "entries.json": json.dumps(
        {"unit": "mm", "sensor": {"taxels": [dict(zip(COLUMNS, row, strict=True)) for row in MILLIMETRES]}}
    ),
    "by_name.yaml": "".join(
        f"T{k}: {{position: {row[:3]}, normal: {row[3:]}}}\n" for k, row in enumerate(ROWS.tolist())
    ),
    "keys.json": json.dumps(
        [{"id": k, "x_mm": r[0], "y_mm": r[1], "z_mm": r[2], "normal_x": r[3], "normal_y": r[4], "normal_z": r[5]}
         for k, r in enumerate(MILLIMETRES)]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", MAKERS)
def test_tables_as_makers_publish_them_are_layouts(rig_with, tmp_path, name):
    (tmp_path / name).write_text(MAKERS[name])
    found = rig_with(f"frame: palm, file: {name}").skin["a"]
    np.testing.assert_allclose(found.points, ROWS[:, :3], atol=1e-9)
    np.testing.assert_allclose(found.normals, ROWS[:, 3:], atol=1e-6)


@pytest.mark.parametrize(
    ("name", "content", "more", "field"),
    [
        ("a.json", json.dumps(MILLIMETRES), "", "skin.a.unit"),
        ("a.csv", MAKERS["names.csv"], ", unit: m", "skin.a.unit"),
        ("a.json", json.dumps({"left": ROWS.tolist(), "right": ROWS.tolist()}), "", "skin.a.file"),
        ("a.yaml", "points: [1, 2]", "", "skin.a.file"),
    ],
)
def test_a_table_in_another_unit_or_one_of_several_is_refused(rig_with, tmp_path, name, content, more, field):
    (tmp_path / name).write_text(content)
    with refused(InvalidFile, field):
        rig_with(f"frame: palm, file: {name}{more}")


def test_a_table_a_csv_in_millimetres_and_json_are_the_same_layout(rig_with, tmp_path):
    table = rig_with(f"frame: palm, taxels: {ROWS.tolist()}").skin["a"]
    lines = ["x,y,z,nx,ny,nz", *(",".join(map(str, row)) for row in ROWS * [1e3, 1e3, 1e3, 1, 1, 1])]
    (tmp_path / "a.csv").write_text("\n".join(lines))
    (tmp_path / "a.json").write_text(json.dumps({"points": ROWS.tolist()}))
    by_csv = rig_with("frame: palm, file: a.csv, unit: mm").skin["a"]
    by_json = rig_with("frame: palm, file: a.json, components: 3").skin["a"]
    for other in (by_csv, by_json):
        np.testing.assert_allclose(other.points, BALL, atol=1e-12)
        np.testing.assert_allclose(other.normals, table.normals, atol=1e-12)
    assert (table.shape, by_json.shape) == ((12,), (12, 3))


def test_any_surface_is_written_and_read_as_the_same(rig_with, tmp_path):
    pose = "pose: {position: [0, 0.01, 0.02], quaternion_xyzw: [0, 1, 0, 1]}"
    rig = rig_with(f"frame: palm, {pose}, rows: 4, columns: 4, pitch: 0.004, radius: 0.01, components: 3")
    (tmp_path / "again.yaml").write_text(text(rig))
    again, surface = Rig.from_file(tmp_path / "again.yaml").skin["a"], rig.skin["a"]
    np.testing.assert_allclose(again.points, surface.points, atol=1e-11)
    np.testing.assert_allclose(again.taxels["axes"], surface.taxels["axes"], atol=1e-10)
    assert again.pitch == pytest.approx(surface.pitch)


def test_a_bent_grid_lies_on_its_cylinder(rig_with):
    surface = rig_with("frame: palm, rows: 5, columns: 7, pitch: 0.003, radius: 0.009").skin["a"]
    to_axis = surface.points + np.array([0, 0, 0.009])
    np.testing.assert_allclose(np.hypot(to_axis[:, 0], to_axis[:, 2]), 0.009)
    np.testing.assert_allclose(surface.normals, to_axis * [1, 0, 1] / 0.009, atol=1e-12)


@pytest.mark.parametrize("order", ["row-major", "column-major"])
def test_the_sensors_of_a_urdf_have_their_taxels_in_the_order_of_the_data(rig_with, order):
    surface = rig_with("urdf: pad", URDF.replace("ORDER", order)).skin["a"]
    assert surface.frame == "index_tip"
    np.testing.assert_allclose(surface.normals, np.tile([1.0, 0, 0], (6, 1)), atol=1e-12)
    step = [0, 0, -0.005] if order == "row-major" else [0, 0.004, 0]
    np.testing.assert_allclose(surface.points[1] - surface.points[0], step, atol=1e-12)
    np.testing.assert_allclose(surface.points[0], [0, 0, 0.033], atol=1e-12)
    listed = rig_with("urdf: list", URDF).skin["a"]
    np.testing.assert_allclose(listed.points, [[0.01, 0, 0], [0.01, 0.004, 0]], atol=1e-12)
    np.testing.assert_allclose(listed.normals[0], se3.rotation_exp(np.array([0, 0.3, 0]))[:, 2], atol=1e-12)


def test_a_product_is_read_from_the_makers_package_where_it_is_installed(rig_with, tmp_path, monkeypatch):
    with refused(InvalidFile, "skin.a.layout"):
        rig_with("frame: palm, layout: 'paxini:DP-X'")
    folder = tmp_path / "site/paxini_sdk/data"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("raise RuntimeError('it must not be imported')")
    points = [dict(zip(("x_mm", "y_mm", "z_mm"), 1e3 * point, strict=True)) for point in BALL]
    value = {"vendor_part_code": "PXSR-1", "sensor_model": "PX6AX-GEN3-DP-X", "points": points}
    (folder / "pxsr_1_points.json").write_text(json.dumps(value))
    monkeypatch.setattr(sys, "path", [str(tmp_path / "site"), *sys.path])
    surface = rig_with("frame: palm, layout: 'paxini:DP-X'").skin["a"]
    np.testing.assert_allclose(surface.points, BALL, atol=1e-12)
    assert (surface.normals * BALL).sum(axis=1).min() > 0.8 * 0.006
    assert surface.shape == (12, 3)
    with refused(InvalidFile, "skin.a.layout"):
        rig_with("frame: palm, layout: 'paxini:DP-Y'")


@pytest.mark.parametrize(("name", "count"), [("xela:fingertip", 30), ("xela:phalanx", 16), ("xela:palm", 24)])
def test_a_product_without_coordinates_has_its_published_count(rig_with, name, count):
    assert rig_with(f"frame: palm, layout: '{name}'").skin["a"].shape[-1] == 3
    assert len(rig_with(f"frame: palm, layout: '{name}'").skin["a"].points) == count


def test_taxels_without_normals_have_those_of_their_links_mesh(rig_with):
    box = '<link name="palm"><visual><geometry><box size="0.02 0.04 0.01"/></geometry></visual></link>'
    urdf = URDF.replace('<link name="palm"/>', box)
    table = "[[0, 0, 0.005], [0, 0.004, 0.005], [0.01, 0.004, 0], [0.01, 0, 0.0]]"
    surface = rig_with(f"frame: palm, taxels: {table}", urdf).skin["a"]
    np.testing.assert_allclose(surface.normals, [[0, 0, 1], [0, 0, 1], [1, 0, 0], [1, 0, 0]], atol=1e-9)
    with refused(InvalidFile, "skin.a"):
        rig_with("frame: palm, taxels: [[0, 0, 0.005], [0, 0, 0.05]]", urdf)


WRONG = {
    "frame: palm": "skin.a",
    "rows: 3, columns: 3, pitch: 0.004": "skin.a.frame",
    "frame: palm, taxels: [[0, 0, 0, 0, 0]]": "skin.a.taxels",
    "frame: palm, taxels: [[0, 0, 0], [0, 0, 0.004]]": "skin.a",
    f"frame: palm, taxels: {(ROWS * [1, 1, 1, -1, -1, -1]).tolist()}": "skin.a",
    f"frame: palm, taxels: {(ROWS * [1e3, 1e3, 1e3, 1, 1, 1]).tolist()}": "skin.a",
    "frame: palm, layout: 'xela:tip'": "skin.a.layout",
    "frame: palm, layout: 'inspire:pad'": "skin.a.pitch",
    "frame: palm, urdf: pad": "skin.a.urdf",
    "frame: palm, file: none.csv": "skin.a",
    "frame: palm, rows: 3, columns: 30, pitch: 0.004, radius: 0.01": "skin.a.radius",
    "frame: palm, rows: 3, columns: 3, pitch: 0.004, scale: 0": "skin.a",
}


@pytest.mark.parametrize("lines", WRONG)
def test_a_wrong_layout_is_refused_by_its_field(rig_with, lines):
    with refused(InvalidFile, WRONG[lines]):
        rig_with(lines)


def test_a_file_of_another_kind_is_refused(rig_with, tmp_path):
    for content in ("x,y\nz,w\n", "1,2,abc\n", "", "[1, 2", "{}", "[1, 2]", '[[1, 2, "a"]]', "3"):
        (tmp_path / "a.csv").write_text(content)
        (tmp_path / "a.json").write_text(content)
        for name in ("a.csv", "a.json"):
            with refused(InvalidFile, "skin.a.file"):
                rig_with(f"frame: palm, file: {name}")


GEL = "indentation: true, frame: palm, rows: 30, columns: 40, pitch: 4.8e-4"


def test_a_gel_is_told_by_its_grid_and_read_as_the_same(rig_with, tmp_path):
    rig = rig_with(GEL + ", scale: -0.001")
    gel = rig.skin["a"]
    assert (gel.indentation, gel.shape) == (True, (30, 40))
    (tmp_path / "again.yaml").write_text(text(rig))
    again = Rig.from_file(tmp_path / "again.yaml").skin["a"]
    assert (again.indentation, again.shape) == (True, (30, 40))
    np.testing.assert_allclose(again.points, gel.points, atol=1e-9)
    np.testing.assert_allclose(again.record["scale"], gel.record["scale"])


def test_a_gel_may_be_bent_and_have_an_image(rig_with):
    bent = rig_with(GEL + ", radius: 0.015").skin["a"]
    assert np.ptp(bent.normals[:, 0]) > 1.0
    np.testing.assert_allclose(np.linalg.norm(bent.points[:, [0, 2]] + [0, 0.015], axis=1), 0.015, atol=1e-12)


def test_a_pad_is_one_taxel_and_read_as_the_same(rig_with, tmp_path):
    rig = rig_with("frame: palm, rows: 1, columns: 1, pitch: 0.026, sigma_normal_deg: 60")
    (tmp_path / "again.yaml").write_text(text(rig))
    pad, again = rig.skin["a"], Rig.from_file(tmp_path / "again.yaml").skin["a"]
    assert not again.indentation
    for values in zip(pad.touch([[1]]).patches[0], again.touch([[1]]).patches[0], strict=True):
        np.testing.assert_allclose(*values, rtol=1e-6, atol=1e-9)


PLAIN = "frame: palm, rows: 3, columns: 4, pitch: 0.004"


@pytest.mark.parametrize(
    ("lines", "field"),
    [
        (PLAIN + ", kind: gel", "skin.a.kind"),
        (PLAIN + ", kind: binary", "skin.a.kind"),
        (PLAIN + ", kind: taxels", "skin.a.kind"),
        (PLAIN + ", image: [4, 4]", "skin.a.image"),
        (PLAIN + ", channels: 15", "skin.a.channels"),
        (PLAIN + ", indentation: 1", "skin.a.indentation"),
        (GEL.replace("4.8e-4", "0.48"), "skin.a.pitch"),
        (GEL + ", components: 3", "skin.a.components"),
        ("indentation: true, frame: palm, rows: 30, pitch: 4.8e-4", "skin.a.columns"),
        (f"{GEL}, stiffness: 1.0e7", "skin.a.stiffness"),
        (PLAIN + ", sigma_stiffness: 1.0e7", "skin.a.sigma_stiffness"),
    ],
)  # fmt: skip
def test_keys_that_went_or_do_not_belong_together_are_refused(rig_with, lines, field):
    with refused(InvalidFile, field):
        rig_with(lines)
