"""Correction problems and their answers as lines of JSON: the contract of `handsight correct`.

A wrong line is answered with `{"error": "contacts[0].point: expected 3 finite numbers, got [nan, 0, 0]"}`: the field,
what was expected, and what came.
"""

import json
import time
from collections import Counter
from pathlib import Path
from typing import Any, NamedTuple

import msgspec
import numpy as np

from handsight import checks, se3
from handsight.batch.run import LONGEST
from handsight.checks import Array
from handsight.contact import Contacts
from handsight.correction import (
    DepthPoints,
    Outside,
    Plane,
    PosePrior,
    SkinEvidence,
    WeightEvidence,
    correct_pose,
)
from handsight.correction.problem import MOST_CONTACTS, check_number
from handsight.errors import HandsightError, InvalidInput
from handsight.msgspec_errors import explain, field_name
from handsight.objects import ObjectModel, ObjectSpec
from handsight.rig.form import ShapeForm


class _Strict(msgspec.Struct, forbid_unknown_fields=True):
    """The base class of the JSON objects; an unknown key is an error, and numbers (`Any`) are checked when used."""


class ContactFields(_Strict):
    point: Any
    normal: Any = None
    sigma_point: Any = None
    sigma_normal_deg: Any = None
    covariance: Any = None
    group: Any = -1


class VisionFields(_Strict):
    position: Any
    quaternion_xyzw: Any
    sigma_position: Any = None
    sigma_rotation_deg: Any = None
    covariance: Any = None


class PlaneFields(_Strict):
    point: Any
    normal: Any
    sigma: Any


class WeightFields(_Strict):
    center_object: Any
    center_palm: Any
    sigma: Any = None
    covariance: Any = None


class DepthFields(_Strict):
    points_palm: Any
    sigma: Any


class SkinFields(_Strict):
    sigmas: Any
    contacts: list[ContactFields] = []
    untouched_palm: Any = []


class ProblemFields(_Strict):
    """A `ProblemFields` is the content of a line; `handsight correct --help` explains each key."""

    object: ShapeForm
    contacts: list[ContactFields]
    contacts_of_residual: bool = False
    shared_covariance: Any = None
    vision: VisionFields | None = None
    outside: Any = None
    planes: list[PlaneFields] = []
    weight: WeightFields | None = None
    depth: DepthFields | None = None
    skin: SkinFields | None = None
    answer: str = "best"
    samples: Any = 0
    budget: Any = None
    method: str = "handsight"


CONFLICT_KEYS = ("evidence", "against", "chi2", "freedom", "p_value", "excluded")


class Problem(NamedTuple):
    """A `Problem` holds the arguments of `correct_pose`."""

    model: ObjectModel
    contacts: Contacts
    vision: PosePrior | None
    options: dict[str, Any]
    """The other arguments, by name."""


class Reader:
    """A `Reader` converts lines of JSON to problems, and keeps the object models that it used last."""

    def __init__(self, folder: Path) -> None:
        """`folder`: relative paths of meshes start here."""
        self.folder = folder
        self._models: dict[ObjectSpec, ObjectModel] = {}
        """The one used last is at the end."""

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
        shared, of_residual = fields.shared_covariance, fields.contacts_of_residual
        contacts = _contacts(fields.contacts, shared, of_residual=of_residual)
        options = {name: getattr(fields, name) for name in ("answer", "samples", "budget", "method")}
        options |= {"outside": outside, "weight": _weight(fields.weight)}
        if (depth := fields.depth) is not None:
            options["depth"] = DepthPoints(depth.points_palm, depth.sigma)
        if (skin := fields.skin) is not None:
            pressed = _contacts(skin.contacts) if skin.contacts else None
            options["skin"] = SkinEvidence(pressed, skin.untouched_palm, skin.sigmas)
        return Problem(self.model(fields.object), contacts, _vision(fields.vision), options)

    def model(self, form: ShapeForm) -> ObjectModel:
        """Returns the object model, built once for lines that name the same object."""
        spec, max_kept = form.entry(self.folder), 32
        if (model := self._models.pop(spec, None)) is None:
            try:
                model = spec.model()
            except HandsightError as error:
                kind = next(iter(form.given()))
                raise InvalidInput(f"object.{kind}: {str(error).removeprefix('name: ')}") from None
        self._models[spec] = model
        if len(self._models) > max_kept:
            del self._models[next(iter(self._models))]
        return model


def answer(problem: Problem) -> dict[str, Any]:
    """Returns the answer to a problem, ready for JSON but for arrays in place of lists; raises InvalidInput."""
    started = time.perf_counter()
    estimate = correct_pose(problem.model, problem.contacts, vision=problem.vision, **problem.options)
    seconds = time.perf_counter() - started
    normal_deg = [None if np.isnan(a) else float(np.rad2deg(a)) for a in estimate.residuals.normal]
    return {
        **se3.position_quaternion(estimate.T_palm_object),
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


def _fields(line: bytes) -> ProblemFields:
    """Returns the fields of a line, with unchecked numbers; raises InvalidInput."""
    if len(line) > LONGEST:
        raise InvalidInput(f"line: expected at most {LONGEST} bytes, got more")
    # Python's parser, as it accepts NaN and Infinity: a later check then names their field.
    try:
        raw = json.loads(line.decode("utf-8"), object_pairs_hook=_unique)
    except UnicodeDecodeError:
        raise InvalidInput("line: expected JSON in UTF-8, got other bytes") from None
    except json.JSONDecodeError as error:
        raise InvalidInput(f"line: expected JSON, got {error.msg} at character {error.pos}") from None
    except InvalidInput:
        raise
    except (RecursionError, ValueError) as error:
        raise InvalidInput(f"line: expected a problem, got JSON that cannot be read ({error})") from None
    if not isinstance(raw, dict):
        raise InvalidInput(f"line: expected an object {{...}}, got {checks.brief(raw)}")
    try:
        return msgspec.convert(raw, ProblemFields)
    except msgspec.ValidationError as error:
        field, message = explain(error, ProblemFields, raw)
        raise InvalidInput(f"{field_name(field)}: {message}") from None
    except UnicodeEncodeError as error:
        raise InvalidInput(f"line: expected text, got half a character in {error.object[:40]!r}") from None


def _unique(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Returns a JSON object as a dictionary; raises InvalidInput for a repeated key."""
    unique = dict(pairs)
    if len(unique) < len(pairs):
        twice = min(key for key, count in Counter(key for key, _ in pairs).items() if count > 1)
        raise InvalidInput(f"{twice}: expected once, got it twice in one object")
    return unique


def _contacts(rows: list[ContactFields], shared: Any = None, *, of_residual: bool = False) -> Contacts:
    if not rows:
        raise InvalidInput("contacts: expected at least one contact, got none")
    n = len(rows)
    check_number(n, MOST_CONTACTS, "contacts", "contacts")
    points, covariance = np.empty((n, 3)), np.zeros((n, 6, 6))
    normals: list[Array | None] = []
    for i, row in enumerate(rows):
        name = f"contacts[{i}]"
        points[i] = checks.in_reach(row.point, f"{name}.point", (3,))
        normals.append(None if row.normal is None else checks.unit(row.normal, f"{name}.normal", (3,)))
        if row.covariance is not None:
            if row.sigma_point is not None or row.sigma_normal_deg is not None:
                raise InvalidInput(f"{name}: expected sigmas or a covariance, got both")
            covariance[i] = checks.covariance(row.covariance, f"{name}.covariance", (6, 6))
            continue
        sigma_point, sigma_normal = 1e-3, 0.1
        if row.sigma_point is not None:
            sigma_point = checks.sigma_point(row.sigma_point, f"{name}.sigma_point")
        if row.sigma_normal_deg is not None:
            sigma_normal = _radians(row.sigma_normal_deg, f"{name}.sigma_normal_deg", np.pi)
        covariance[i] = np.diag(np.repeat([sigma_point**2, sigma_normal**2], 3))
    groups = [row.group for row in rows]
    group = None if shared is None and all(g == -1 for g in groups) else groups
    noise: dict[str, Any] = {"covariance": covariance, "of_residual": of_residual}
    try:
        return Contacts(points, normals, **noise, group=group, shared_covariance=shared)
    except InvalidInput as error:
        raise InvalidInput(f"contacts: {error}") from None


def _vision(fields: VisionFields | None) -> PosePrior | None:
    if fields is None:
        return None
    position = checks.in_reach(fields.position, "vision.position", (3,))
    quaternion = checks.unit(fields.quaternion_xyzw, "vision.quaternion_xyzw", (4,))
    length = float(np.linalg.norm(fields.quaternion_xyzw))
    if abs(length - 1) > 0.02:  # more than rounding to two digits: other numbers, or in another order
        raise InvalidInput(f"vision.quaternion_xyzw: expected a length of 1, got {length:.4g}")
    T = se3.compose(se3.rotation_from_quaternion(quaternion), position)
    given = [value is not None for value in (fields.sigma_position, fields.sigma_rotation_deg)]
    if (fields.covariance is not None) == any(given):
        expected = "expected sigma_position and sigma_rotation_deg or a covariance"
        raise InvalidInput(f"vision: {expected}, got {'both' if any(given) else 'neither'}")
    if fields.covariance is not None:
        return PosePrior(T, checks.covariance(fields.covariance, "vision.covariance", (6, 6)))
    for field in ("sigma_position", "sigma_rotation_deg"):
        if getattr(fields, field) is None:
            raise InvalidInput(f"vision.{field}: expected a number above 0, got nothing")
    shift = checks.sigma(fields.sigma_position, "vision.sigma_position")
    turn = _radians(fields.sigma_rotation_deg, "vision.sigma_rotation_deg", np.pi)
    return PosePrior.from_sigmas(T, shift, turn)


def _weight(fields: WeightFields | None) -> WeightEvidence | None:
    if fields is None:
        return None
    if (fields.sigma is None) == (fields.covariance is None):
        came = "neither" if fields.sigma is None else "both"
        raise InvalidInput(f"weight: expected a sigma or a covariance, got {came}")
    covariance = fields.covariance
    if fields.sigma is not None:
        covariance = checks.sigma(fields.sigma, "weight.sigma") ** 2 * np.eye(3)
    return WeightEvidence(fields.center_object, fields.center_palm, covariance)


def _radians(degrees: float, name: str, most: float) -> float:
    """Returns a standard deviation in radians from degrees, checked to be at most `most` [rad]; raises InvalidInput."""
    radians = float(np.deg2rad(checks.positive(degrees, name)))
    if not checks.MIN_SIGMA <= radians <= most:
        lowest, highest = np.rad2deg([checks.MIN_SIGMA, most])
        raise InvalidInput(f"{name}: expected degrees from {lowest:.1g} to {highest:.3g}, got {degrees:g}")
    return radians
