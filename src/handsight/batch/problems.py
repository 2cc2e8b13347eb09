"""Correction problems and their answers as lines of JSON: the contract of `handsight correct`.

A wrong line is answered with `{"error": "contacts[0].point: expected 3 finite numbers, got [nan, 0, 0]"}`: the field,
what was expected, and what came.
"""

import json
import re
import time
from collections import Counter
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, NamedTuple, TypeVar

import msgspec
import numpy as np
from msgspec import Meta

from handsight import checks, se3
from handsight.batch.blocks import LONGEST
from handsight.contact import Contacts
from handsight.correction import (
    Outside,
    Plane,
    PosePrior,
    SkinEvidence,
    WeightEvidence,
    correct_pose,
)
from handsight.correction.problem import MOST_CONTACTS, check_number
from handsight.errors import HandsightError, InvalidFile, InvalidInput
from handsight.files import read_bytes
from handsight.msgspec_errors import explain, field_name
from handsight.objects import ObjectModel, ObjectSpec
from handsight.rig.form import ShapeForm

MAX_TOUCHES = 1 << 24
"""Bytes of a file of touches."""
Fields = TypeVar("Fields", bound=msgspec.Struct)
Degrees = Annotated[float, Meta(gt=0, le=180)]


class _Strict(msgspec.Struct, forbid_unknown_fields=True):
    """The base class of the JSON objects; an unknown key is an error, and numbers (`Any`) are checked when used."""


class ContactFields(_Strict):
    point: Any
    normal: Any = None
    sigma_point: Any = None
    sigma_normal_deg: Degrees | None = None
    covariance: Any = None
    group: Any = -1


class VisionFields(_Strict):
    position: Any
    quaternion_xyzw: Any
    sigma_position: Any = None
    sigma_rotation_deg: Degrees | None = None
    covariance: Any = None


class TouchFields(_Strict):
    """A line of touches of an object whose model has no scale; `object` may stand there, and is not used."""

    contacts: list[ContactFields]
    object: Any = None
    shared_covariance: Any = None
    vision: VisionFields | None = None


class PlaneFields(_Strict):
    point: Any
    normal: Any
    sigma: Any


class WeightFields(_Strict):
    center_object: Any
    center_palm: Any
    sigma: Any = None
    covariance: Any = None


class SkinFields(_Strict):
    sigmas: Any
    contacts: list[ContactFields] = []
    untouched_palm: Any = []


class ProblemFields(_Strict):
    """The content of a line; `handsight correct --help` explains each key."""

    object: ShapeForm
    contacts: list[ContactFields]
    shared_covariance: Any = None
    vision: VisionFields | None = None
    outside: Any = None
    planes: list[PlaneFields] = []
    weight: WeightFields | None = None
    skin: SkinFields | None = None
    method: str = "handsight"


GONE = {
    "answer": "use `position` of the answer, the mean where a mode is not Gaussian, or `maximum`",
    "samples": "use the answer's `covariance`, which is integrated",
    "budget": "stop the program that answers instead",
    "depth": "use `vision`, the pose that was found in the same image",
    "contacts_of_residual": "use `covariance` of each contact, without the errors of the model's surface",
}
"""Keys of a line that are refused, and what to use instead."""

CONFLICT_KEYS = ("evidence", "against", "chi2", "freedom", "p_value", "excluded")


class Problem(NamedTuple):
    """The arguments of `correct_pose`."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    options: dict[str, Any]
    """The other arguments, by name."""


class Reader:
    """Conversion of lines of JSON to problems, which keeps the object models that were used last."""

    def __init__(self, folder: Path) -> None:
        """`folder`: relative paths of meshes start here."""
        self.folder = folder
        self._model = lru_cache(maxsize=32)(ObjectSpec.model)

    def read(self, line: bytes) -> Problem:
        """Returns the problem of one line; raises a HandsightError that names the field."""
        fields = _fields(line)
        outside: Any = None
        if fields.outside is not None and fields.outside != []:
            outside = checks.position(fields.outside, "outside", (None, 3))
        planes = list[Plane]()
        for i, plane in enumerate(fields.planes):
            point = checks.in_reach(plane.point, f"planes[{i}].point", (3,))
            normal = checks.unit(plane.normal, f"planes[{i}].normal", (3,))
            planes.append(Plane(point, normal, checks.sigma(plane.sigma, f"planes[{i}].sigma")))
        if planes:
            outside = Outside(() if outside is None else outside, planes)
        contacts = _contacts(fields.contacts, fields.shared_covariance)
        options = {"outside": outside, "weight": _weight(fields.weight), "method": fields.method}
        if (skin := fields.skin) is not None:
            pressed = _contacts(skin.contacts) if skin.contacts else None
            options["skin"] = SkinEvidence(pressed, skin.untouched_palm, skin.sigmas)
        return Problem(self.model(fields.object), contacts, _vision(fields.vision), options)

    def model(self, form: ShapeForm) -> ObjectModel:
        """Returns the object model, built once for lines that name the same object."""
        spec = form.entry(self.folder)
        try:
            return self._model(spec)
        except HandsightError as error:
            kind = next(iter(form.given()))
            raise InvalidInput(f"object.{kind}: {str(error).removeprefix('name: ')}") from None


def answer(problem: Problem) -> dict[str, Any]:
    """Returns the answer to a problem, ready for JSON but for arrays in place of lists; raises InvalidInput."""
    started = time.perf_counter()
    estimate = correct_pose(problem.model, problem.contacts, vision=problem.vision, **problem.options)
    seconds = time.perf_counter() - started
    normal_deg = [None if np.isnan(a) else float(np.rad2deg(a)) for a in estimate.residuals.normal]
    return {
        **se3.position_quaternion(estimate.T_palm_object),
        "maximum": se3.position_quaternion(estimate.T_palm_object_maximum),
        "covariance": estimate.covariance,
        "information": estimate.information,
        "converged": estimate.converged,
        "iterations": estimate.iterations,
        "seconds": seconds,
        "residuals": {"distance": estimate.residuals.distance, "normal_deg": normal_deg},
        "unobservable": estimate.unobservable,
        "consistent": estimate.consistent,
        "outliers": list(estimate.outliers),
        "conflicts": [
            {key: getattr(conflict, key) for key in CONFLICT_KEYS} | {"message": str(conflict)}
            for conflict in estimate.conflicts
        ],
        "hypotheses": [
            se3.position_quaternion(h.T_palm_object) | {"covariance": h.covariance, "weight": h.weight}
            for h in estimate.hypotheses
        ],
    }


def answer_text(reader: Reader, line: bytes) -> str:
    """Returns the answer to a line as a line of JSON without its newline; `{"error": ...}` if it cannot be solved."""
    try:
        return json.dumps(answer(reader.read(line)), allow_nan=False, default=np.ndarray.tolist)
    except HandsightError as error:
        message = str(error)
    except MemoryError:
        message = "line: expected a problem that fits into memory, got a larger one"
    except Exception as error:  # a bug; the other lines are still answered
        message = f"line: expected an answer, got {type(error).__name__}: {error} (a fault of handsight's)"
    return json.dumps({"error": message})


def read_touches(path: Path) -> tuple[Contacts, PosePrior | None]:
    """Returns the touches in a file, and roughly the object's pose where it has that; all in one frame.

    The file has one line, with contacts as a problem has them, or a contact a line, as `handsight contact` writes it.
    Raises InvalidFile, which names the field.
    """
    lines = [line for line in read_bytes(path, MAX_TOUCHES, str(path)).splitlines() if line.strip()]
    try:
        fields = _touches(lines)
        return _contacts(fields.contacts, fields.shared_covariance), _vision(fields.vision)
    except InvalidInput as error:
        raise InvalidFile(f"{path}: {error}") from None


def _touches(lines: list[bytes]) -> TouchFields:
    """Returns the fields of the only line, or of all lines that are contacts; raises InvalidInput."""
    if not lines:
        raise InvalidInput("line: expected contacts, got no line")
    rows = [_decoded(line) for line in lines]
    if "contacts" in rows[0]:
        if len(rows) > 1:
            raise InvalidInput(f"line: expected one, as all touches are of one grasp, got {len(rows)}")
        return _converted(rows[0], TouchFields)
    touched = [row for row in rows if row.get("reason", "contact") == "contact"]
    known = ContactFields.__struct_fields__
    contacts = [{key: row[key] for key in known if key in row} for row in touched]
    return _converted({"contacts": contacts}, TouchFields)


def _fields(line: bytes) -> ProblemFields:
    """Returns the fields of a line, with unchecked numbers; raises InvalidInput."""
    raw = _decoded(line)
    for key, instead in GONE.items():
        if key in raw:
            raise InvalidInput(f"{key}: expected no such key, which was removed ({instead}), got it")
    return _converted(raw, ProblemFields)


def _decoded(line: bytes) -> dict[str, Any]:
    """Returns the object of a line of JSON; raises InvalidInput."""
    if len(line) > LONGEST:
        raise InvalidInput(f"line: expected at most {LONGEST} bytes, got more")
    # Python's parser, as it accepts NaN and Infinity: a later check then names their field.
    try:
        raw = json.loads(line.decode("utf-8"), object_pairs_hook=_unique)
    except InvalidInput:
        raise
    except (RecursionError, ValueError) as error:
        raise InvalidInput(f"line: expected JSON in UTF-8, got other text ({error})") from None
    if not isinstance(raw, dict):
        raise InvalidInput(f"line: expected an object {{...}}, got {checks.brief(raw)}")
    return raw


def _converted(raw: dict[str, Any], form: type[Fields]) -> Fields:
    """Returns the fields of a JSON object, with unchecked numbers; raises InvalidInput."""
    try:
        return msgspec.convert(raw, form)
    except msgspec.ValidationError:
        field, message = explain(form, raw)
        raise InvalidInput(f"{field_name(field)}: {message}") from None
    except UnicodeEncodeError as error:
        raise InvalidInput(f"line: expected text, got half a character in {error.object[:40]!r}") from None


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Returns a JSON object as a dictionary; raises InvalidInput for a repeated key."""
    unique = dict(pairs)
    if len(unique) < len(pairs):
        counts = Counter(key for key, _ in pairs)
        twice, _ = counts.most_common(1)[0]
        raise InvalidInput(f"{twice}: expected once, got it twice in one object")
    return unique


def _contacts(rows: list[ContactFields], shared: Any = None) -> Contacts:
    check_number(len(rows), MOST_CONTACTS, "contacts", "contacts")
    points = [row.point for row in rows]
    normals = list[Any]()
    covariances = list[Any]()
    for i, row in enumerate(rows):
        name = f"contacts[{i}]"
        normals.append(None if row.normal is None else checks.unit(row.normal, f"{name}.normal", (3,)))
        covariances.append(_covariance(row, name))
    groups = [row.group for row in rows]
    group = None if shared is None and all(g == -1 for g in groups) else groups
    try:
        return Contacts(points, normals, covariance=covariances, group=group, shared_covariance=shared)
    except InvalidInput as error:
        # Its arguments have other names than a line's keys.
        message = str(error).removeprefix("points_palm: ")
        message = re.sub(r"^points_palm(\[\d+\])", r"\1.point", message)
        message = re.sub(r"^covariance(\[\d+\])", r"\1.covariance", message)
        between = "" if message.startswith("[") else ": "
        raise InvalidInput(f"contacts{between}{message}") from None


def _covariance(row: ContactFields, name: str) -> Any:
    """Returns a contact's covariance (6, 6), not yet checked if it was given; raises InvalidInput."""
    if row.covariance is None:
        sigma_point = 1e-3
        sigma_normal = 0.1
        if row.sigma_point is not None:
            sigma_point = checks.sigma_point(row.sigma_point, f"{name}.sigma_point")
        if row.sigma_normal_deg is not None:
            sigma_normal = float(np.deg2rad(row.sigma_normal_deg))
        return np.diag(np.repeat([sigma_point**2, sigma_normal**2], 3))
    if row.sigma_point is not None or row.sigma_normal_deg is not None:
        raise InvalidInput(f"{name}: expected sigmas or a covariance, got both")
    return row.covariance


def _vision(fields: VisionFields | None) -> PosePrior | None:
    if fields is None:
        return None
    position = checks.in_reach(fields.position, "vision.position", (3,))
    quaternion = checks.unit(fields.quaternion_xyzw, "vision.quaternion_xyzw", (4,))
    length = float(np.linalg.norm(fields.quaternion_xyzw))
    if abs(length - 1) > 0.02:  # more than rounding to two digits: other numbers, or in another order
        raise InvalidInput(f"vision.quaternion_xyzw: expected a length of 1, got {length:.4g}")
    T = se3.compose(se3.rotation_from_quaternion(quaternion), position)
    given = _given(fields, "sigma_position", "sigma_rotation_deg", "covariance")
    if given == ["covariance"]:
        return PosePrior(T, fields.covariance)
    if given != ["sigma_position", "sigma_rotation_deg"]:
        expected = "expected sigma_position and sigma_rotation_deg or a covariance"
        raise InvalidInput(f"vision: {expected}, got {', '.join(given) or 'neither'}")
    sigma_position = checks.sigma(fields.sigma_position, "vision.sigma_position")
    return PosePrior.from_sigmas(T, sigma_position, float(np.deg2rad(fields.sigma_rotation_deg or 0.0)))


def _weight(fields: WeightFields | None) -> WeightEvidence | None:
    if fields is None:
        return None
    given = _given(fields, "sigma", "covariance")
    if len(given) != 1:
        raise InvalidInput(f"weight: expected a sigma or a covariance, got {', '.join(given) or 'neither'}")
    covariance = fields.covariance
    if fields.sigma is not None:
        covariance = checks.sigma(fields.sigma, "weight.sigma") ** 2 * np.eye(3)
    return WeightEvidence(fields.center_object, fields.center_palm, covariance)


def _given(fields: _Strict, *names: str) -> list[str]:
    """Returns those of the keys that are not null."""
    return [name for name in names if getattr(fields, name) is not None]
