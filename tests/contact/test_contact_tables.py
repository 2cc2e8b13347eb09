import csv
import io
import json

import numpy as np
import pytest

from contact.contact_cases import PAPER_TIP, touches
from handsight.contact import Ellipsoid, contact_from_wrench, convert
from handsight.errors import InvalidFile, InvalidInput
from testbed.refusals import refused

COLUMNS = [
    "reason",
    "x",
    "y",
    "z",
    "nx",
    "ny",
    "nz",
    "force_normal",
    "force_tangential_x",
    "force_tangential_y",
    "force_tangential_z",
    "torque",
    "sigma_x",
    "sigma_y",
    "sigma_z",
    "sigma_normal",
]
TIP = Ellipsoid(PAPER_TIP, cap=0.0, max_friction=1.0)
HEADER = "stamp,finger,fx,fy,fz,tx,ty,tz\n"
FIVE = HEADER + (
    "1712345678.123456789,ff,0,0,-1,0,0,0\n"
    "2,mf,0,0,-0.01,0,0,0\n"
    "3,rf,0,0,1,0,0,0\n"
    '4,"l,f",0,,nan,0,0,0\n'
    "5,th,3,0,-1,0,0.036,0\n"
)


def converted(text, tip=TIP, **options):
    out = io.StringIO()
    return convert(io.StringIO(text), out, tip, **options), out.getvalue()


def test_every_row_of_csv_is_answered_in_order_with_its_reason():
    counts, text = converted(FIVE)
    rows = list(csv.DictReader(io.StringIO(text)))
    assert [row["reason"] for row in rows] == ["contact", "free", "off_cap", "invalid", "beyond_friction"]
    assert [row["finger"] for row in rows] == ["ff", "mf", "rf", "l,f", "th"]
    assert rows[0]["stamp"] == "1712345678.123456789"
    assert counts == {"contact": 1, "free": 1, "off_cap": 1, "beyond_friction": 1, "invalid": 1}
    assert tuple(rows[0]) == ("stamp", "finger", *COLUMNS)
    assert all(rows[1][column] == "" for column in COLUMNS[1:])


def test_the_numbers_of_csv_are_the_contact_s():
    truth = touches(np.random.default_rng(0), TIP, 50, friction=0.9)
    table = "tz,ty,tx,fz,fy,fx\n" + "".join(
        ",".join(map(repr, [*m[::-1].tolist(), *f[::-1].tolist()])) + "\n"
        for f, m in zip(truth.forces, truth.torques, strict=True)
    )
    _, text = converted(table, sigma_force=0.02, sigma_torque=1e-4)
    rows = list(csv.DictReader(io.StringIO(text)))
    assert len(rows) == 50
    for f, m, row in zip(truth.forces, truth.torques, rows, strict=True):
        contact = contact_from_wrench(f, m, TIP, sigma_force=0.02, sigma_torque=1e-4)
        deviation = np.sqrt(np.diag(contact.covariance))
        expected = [
            *contact.point,
            *contact.normal,
            contact.force_normal,
            *contact.force_tangential,
            contact.torque,
            *deviation[:3],
            np.sqrt((deviation[3:] ** 2).sum() / 2),
        ]
        np.testing.assert_allclose([float(row[c]) for c in COLUMNS[1:]], expected, rtol=1e-8, atol=1e-15)


def test_json_lines_say_the_same_as_csv_and_carry_the_covariance():
    lines = [
        {"stamp": 1.5, "finger": "ff", "force": [0.1, 0, -1], "torque": [0, 0.0012, 1e-4]},
        {"stamp": 2, "finger": "ff", "force": [0, None, -1], "torque": [0, 0, 0]},
        {"stamp": None, "finger": 3, "force": [0, 0, 0], "torque": [0, 0, 0]},
    ]
    text = "\n\n".join(map(json.dumps, lines)) + "\n"
    counts, out = converted(text, format="jsonl")
    first, second, third = map(json.loads, out.splitlines())
    contact = contact_from_wrench([0.1, 0, -1], [0, 0.0012, 1e-4], TIP)
    assert first["point"] == contact.point.tolist()
    assert first["normal"] == contact.normal.tolist()
    assert first["covariance"] == contact.covariance.tolist()
    assert first["force_tangential"] == contact.force_tangential.tolist()
    assert (first["torque"], first["force_normal"]) == (contact.torque, contact.force_normal)
    assert second == {"stamp": 2, "finger": "ff", "reason": "invalid"}
    assert third == {"stamp": None, "finger": 3, "reason": "free"}
    assert (counts["contact"], counts["invalid"], counts["free"]) == (1, 1, 1)


def test_a_stamp_from_csv_keeps_all_its_digits_as_a_json_number():
    _, out = converted(FIVE, format="jsonl")
    assert out.startswith('{"stamp":1712345678.123456789,"finger":"ff","reason":"contact"')
    assert json.loads(out.splitlines()[3])["finger"] == "l,f"


def test_files_are_converted_by_their_names(tmp_path):
    source = tmp_path / "wrenches.csv"
    source.write_text("\ufeff" + FIVE, encoding="utf-8")
    convert(source, tmp_path / "contacts.jsonl", TIP)
    convert(str(source), str(tmp_path / "contacts.csv"), TIP)
    lines = (tmp_path / "contacts.jsonl").read_text().splitlines()
    assert [json.loads(line)["reason"] for line in lines][:2] == ["contact", "free"]
    assert (tmp_path / "contacts.csv").read_text().startswith("stamp,finger,reason,x,y,z,")
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        "contacts.csv",
        "contacts.jsonl",
        "wrenches.csv",
    ]


def test_a_table_that_breaks_off_leaves_the_old_answer_and_no_half_of_a_new_one(tmp_path):
    destination = tmp_path / "contacts.csv"
    destination.write_text("old")
    with pytest.raises(InvalidFile):
        convert(io.StringIO(HEADER + "1,ff,0,0,-1,0,0,0\n" * 9000 + "1,ff,0\n"), destination, TIP)
    assert destination.read_text() == "old"
    assert [path.name for path in tmp_path.iterdir()] == ["contacts.csv"]


@pytest.mark.parametrize(
    ("text", "field"),
    [
        ("", "w"),
        ("\n  \n", "w"),
        (HEADER, "w"),
        ("fx,fy,fz,tx,ty\n", "line 1"),
        ("1,2,3,4,5,6\n", "line 1"),
        ("\nfx,fy,fz,tx,ty,tz,q\n", "line 2"),
        ("fx,fy,fz,tx,ty,tz,fx\n", "line 1"),
        ("fx,fy,fz,tx,ty,tz\n0,0,0,0,0,0\n1,2,3\n", "line 3"),
        ("fx,fy,fz,tx,ty,tz\n0,0,0,0,0,0\n\n0,0,0,0,1.2.3,0\n", "line 4, column ty"),
        ("fx,fy,fz,tx,ty,tz\n0,0,0,0,0,1_0\n", "line 2, column tz"),
        ('fx,fy,fz,tx,ty,tz\n0,0,0,0,0,"1\n', "line 2"),
        ('{"force": [0, 0, 0]\n', "line 1"),
        ('{"force":[0,0,0],"torque":[0,0,0]}\n\n[1]\n', "line 3"),
        ('{"force":[0,0,0]}', "line 1"),
        ('{"force":[0,0],"torque":[0,0,0]}', "line 1"),
        ('{"force":[0,0,true],"torque":[0,0,0]}', "line 1"),
        ('{"force":[0,0,0],"torque":["0",0,0]}', "line 1"),
        ('{"force":[0,0,0],"torque":[0,0,1' + "0" * 400 + "]}", "line 1"),
        ('{"Force":[0,0,0],"torque":[0,0,0]}', "line 1"),
        ('{"force":[0,0,0],"torque":[0,0,0],"stamp":[1]}', "line 1"),
        ('{"force":[0,0,0],"torque":[0,0,0],"stamp":1}\n{"force":[0,0,0],"torque":[0,0,0]}', "line 2"),
    ],
)
def test_a_malformed_table_is_refused_by_file_line_and_column(tmp_path, monkeypatch, text, field):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "w").write_text(text)
    with refused(InvalidFile, field):
        convert("w", "out.csv", TIP)
    assert not (tmp_path / "out.csv").exists()


def test_a_file_that_cannot_be_read_or_written_is_named(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with refused(InvalidFile, "absent.csv"):
        convert("absent.csv", "out.csv", TIP)
    (tmp_path / "w.csv").write_text(FIVE)
    with refused(InvalidFile, "where.csv"):
        convert("w.csv", "no/where.csv", TIP)
    (tmp_path / "w.bin").write_bytes(b"\xff\xfe0")
    with refused(InvalidFile, "w.bin"):
        convert("w.bin", "out.csv", TIP)


def test_an_unknown_format_is_refused():
    with refused(InvalidInput, "format"):
        converted(FIVE, format="xml")
