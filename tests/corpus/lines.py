"""Problems as JSON lines, and tables of wrenches: corrupted values, text and bytes."""

import io
import json
import math
import random
from pathlib import Path

from handsight.batch.problems import Reader, answer_text
from handsight.batch.run import blocks
from handsight.contact import Sphere, convert
from handsight.errors import HandsightError
from tests.corpus.door import Case, Door, spoilt_bytes, spoilt_text, spoilt_value

PROBLEM = {
    "object": {"box": [0.06, 0.09, 0.14]},
    "contacts": [
        {
            "point": [0.03, 0.01, 0.03],
            "normal": [1.0, 0.0, 0.0],
            "sigma_point": 0.001,
            "sigma_normal_deg": 5.0,
        },
        {"point": [-0.01, 0.045, 0.02], "normal": [0.0, 1.0, 0.0]},
        {"point": [0.01, 0.02, 0.07], "covariance": [[1e-6 * (i == j) for j in range(6)] for i in range(6)]},
    ],
    "vision": {
        "position": [0.02, -0.01, 0.015],
        "quaternion_xyzw": [0.025, 0.01, -0.02, 1.0],
        "sigma_position": 0.03,
        "sigma_rotation_deg": 15.0,
    },
    "outside": [[0.05, 0.1, 0.1], [0.2, 0.0, 0.0]],
    "answer": "best",
    "samples": 0,
    "budget": 10.0,
    "method": "handsight",
}
CYLINDER = {"cylinder": {"radius": 0.033, "height": 0.115}}
LINE = json.dumps(PROBLEM)
WRENCHES = "\n".join(
    [
        "stamp,finger,fx,fy,fz,tx,ty,tz",
        "1712345678.123456789,ff,0.1,0,-1,0,0.0012,0.0001",
        '2,"l,f",0,0,-0.01,0,0,0',
        "3,th,3,0,-1,0,0.036,0",
        "4,mf,0,,nan,0,0,0\n",
    ]
)
WRENCH_LINES = "".join(
    json.dumps({"stamp": stamp, "finger": "ff", "force": [0.1, y, -1.0], "torque": [0.0, 0.0012, 1e-4]})
    + "\n"
    for stamp, y in ((1.5, 0.0), (2, None), ("3", 0.2))
)
TIP = Sphere(0.008, cap=0.0, max_friction=1.0)
READER = Reader(Path(__file__).parent)


def answer(line: bytes) -> None:
    """Solves the problem in a line, and asserts that the answer is finite; raises the refusal in an `error`."""
    for lines in blocks(io.BytesIO(line)):
        for each in lines:
            text = answer_text(READER, each)
            assert "\n" not in text
            check_numbers(found := json.loads(text))
            if "error" in found:
                raise HandsightError(found["error"])
            assert abs(sum(h["weight"] for h in found["hypotheses"]) - 1) < 1e-9


def convert_text(data: bytes) -> None:
    """Converts a table of wrenches, as CSV or JSON; asserts a row for each wrench, with finite numbers."""
    for format in ("csv", "jsonl"):
        sink = io.StringIO()
        source = io.TextIOWrapper(io.BytesIO(data), encoding="utf-8", newline="")
        counts = convert(source, sink, TIP, format=format)
        rows = sink.getvalue().encode().decode().splitlines()
        assert sum(counts.values()) > 0
        if format == "jsonl":
            assert len(rows) == sum(counts.values())
            for row in map(json.loads, rows):
                check_numbers({key: row[key] for key in row.keys() - {"stamp", "finger"}})


def check_numbers(value: object) -> None:
    """Asserts that every number in a value is finite."""
    if isinstance(value, dict | list):
        for part in value.values() if isinstance(value, dict) else value:
            check_numbers(part)
    elif isinstance(value, float):
        assert math.isfinite(value), value


def values_spoilt(rng: random.Random) -> None:
    """Solves a problem with one or two corrupted values."""
    given: object = PROBLEM | rng.choice([{}, {"object": CYLINDER}, {"vision": None}, {"samples": 100}])
    for _ in range(rng.choice([1, 1, 2])):
        given = spoilt_value(given, rng)
    answer(json.dumps(given, default=str).encode())


def line_spoilt(rng: random.Random) -> None:
    """Solves a problem whose text or bytes are damaged."""
    if rng.random() < 0.5:
        answer(spoilt_text(LINE, rng).encode("utf-8", "surrogatepass"))
    else:
        answer(spoilt_bytes(LINE.encode(), rng))


def table_spoilt(rng: random.Random) -> None:
    """Converts a table with damaged text or bytes, in either format; its words are separated by commas."""
    table = rng.choice([WRENCHES, WRENCH_LINES])
    if rng.random() < 0.3:
        convert_text(spoilt_bytes(table.encode(), rng))
        return
    separator = rng.choice([",", " "])
    text = spoilt_text(table.replace(" ", "").replace(",", " "), rng).replace(" ", ",")
    convert_text((text if separator == "," else spoilt_text(table, rng)).encode())


def wrench_spoilt(rng: random.Random) -> None:
    """Converts a wrench as JSON with a corrupted value."""
    rows = [json.loads(line) for line in WRENCH_LINES.splitlines()]
    i = rng.randrange(len(rows))
    rows[i] = spoilt_value(rows[i], rng)
    convert_text("".join(json.dumps(row, default=str) + "\n" for row in rows).encode())


def _changed(**fields: object) -> bytes:
    return json.dumps(PROBLEM | fields).encode()


def _contact(**fields: object) -> bytes:
    return _changed(contacts=[PROBLEM["contacts"][0] | fields])


def _vision(**fields: object) -> bytes:
    return _changed(vision=PROBLEM["vision"] | fields)


DOORS = [
    Door("a line's values", values_spoilt, 250),
    Door("a line's text", line_spoilt, 100),
    Door("wrenches' text", table_spoilt, 150),
    Door("wrenches' values", wrench_spoilt, 100),
]
TWICE = ("{" + ",".join(f'"k{i % 20_000}": 1' for i in range(40_000)) + "}").encode()
CASES = [
    Case(
        "40 000 keys",
        lambda: answer(json.dumps({f"k{i}": i for i in range(40_000)}).encode()),
        "k0: unknown key",
    ),
    Case("20 000 keys twice each", lambda: answer(TWICE), "k0: expected once, got it twice"),
    Case("a key of a million letters", lambda: answer(json.dumps({"x" * 10**6: 1}).encode()), "xxx"),
    Case(
        "a list in a list, 900 deep",
        lambda: answer(LINE.replace("[0.06, 0.09, 0.14]", "[" * 900 + "]" * 900).encode()),
        "object.box: expected 3 finite numbers",
    ),
    Case(
        "a mesh named by half a character",
        lambda: answer(_changed(object={"mesh": "\ud800.ply"})),
        "object.mesh",
    ),
    Case("a method so named", lambda: answer(_changed(method="\ud800")), "method: expected one of"),
    Case("a key so named", lambda: answer(_changed(**{"\ud800": 1})), "line: expected text"),
    Case(
        "a side of 1e400 digits",
        lambda: answer(_changed(object={"box": [10**400, 1, 1]})),
        "object.box[0]: expected",
    ),
    Case(
        "a billion samples", lambda: answer(_changed(samples=999_999_999)), "samples: expected a whole number"
    ),
    Case(
        "a sigma of 200 m",
        lambda: answer(_contact(sigma_point=200)),
        "sigma_point: expected metres within 5, got 200 (milli",
    ),
    Case(
        "a normal known to 400 degrees",
        lambda: answer(_contact(sigma_normal_deg=400)),
        "expected degrees from 6e-08 to 180",
    ),
    Case(
        "a contact in millimetres",
        lambda: answer(_contact(point=[31, 0, 100])),
        "got [31, 0, 100] (millimetres? [0.031",
    ),
    Case(
        "vision in millimetres",
        lambda: answer(_vision(position=[20, 0, 100])),
        "vision.position: expected metres within 5",
    ),
    Case(
        "a quaternion that is none",
        lambda: answer(_vision(quaternion_xyzw=[1, 2, 0, 0])),
        "vision.quaternion_xyzw: expected a length of 1, got 2.236",
    ),
    Case("a mark before the first line", lambda: answer("\ufeff".encode() + LINE.encode()), None),
    Case("two marks", lambda: answer("\ufeff\ufeff".encode() + LINE.encode()), "line: expected JSON"),
    Case("a mark later", lambda: answer(f"{LINE}\n\ufeff{LINE}".encode()), "line: expected JSON"),
    Case("a mark before a table", lambda: convert_text(f"\ufeff{WRENCHES}".encode()), None),
    Case("a mark before wrenches as JSON", lambda: convert_text(f"\ufeff{WRENCH_LINES}".encode()), None),
    Case(
        "two marks before a table",
        lambda: convert_text(f"\ufeff\ufeff{WRENCHES}".encode()),
        "got column '\\ufeff",
    ),
    Case(
        "a mark within a table",
        lambda: convert_text(WRENCHES.replace("0.1,0", "\ufeff0.1,0").encode()),
        "column fx",
    ),
    Case("a table of one line", lambda: convert_text(b"0" * 10**6), "line 1: expected at most"),
    Case(
        "a finger named by half a character",
        lambda: convert_text(b'{"finger": "\\ud800", "force": [0, 0, -1], "torque": [0, 0, 0]}'),
        "line 1: finger: expected",
    ),
    Case(
        "a force of 1e300 N",
        lambda: convert_text(WRENCHES.replace("0.1,0,-1", "0.1,0,-1e300").encode()),
        "column fz",
    ),
    Case(
        "a torque of 1e300 N m",
        lambda: convert_text(WRENCH_LINES.replace("0.0012", "1e300").encode()),
        "torque: expected newtons",
    ),
    Case(
        "a stamp of NaN",
        lambda: convert_text(WRENCH_LINES.replace('"stamp": 2', '"stamp": NaN').encode()),
        "stamp: expected",
    ),
]
