"""Fingertips as a user types them: `ellipsoid:8,8,12mm,cap=-2mm,friction=1.2`."""

import re
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from handsight.checks import Array
from handsight.contact.fingertips import Ellipsoid, Fingertip, Sphere
from handsight.errors import InvalidInput

UNITS = {"mm": 1e-3, "cm": 1e-2, "m": 1.0}
"""Metres each."""
FINGERTIP_HELP = """\
ellipsoid:A,B,C<unit> or sphere:R<unit>, semi-axes along x, y, z of the tip, which points along +z;
then options, each after a comma (or a semicolon):
  cap=Z<unit>         least z that is sensed, from the centre (without it: the whole closed surface)
  friction=MU         largest tangential / normal force (without it: no limit)
  min_force=F         newtons below which nothing is touched (0.1)
  sensor=X,Y,Z<unit>  where the sensor's origin sits in the surface's frame, its axes parallel
                      (without it: at the centre)
A length needs its unit: mm, cm or m. Example: ellipsoid:8,8,12mm,cap=-2mm,friction=1.2
"""

_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z]*)")


def parse_fingertip(text: str) -> Fingertip:
    """The fingertip that `text` describes, in metres; the grammar is `FINGERTIP_HELP`.

    Raises InvalidInput that quotes the part at fault.
    """
    shape, colon, rest = text.partition(":")
    shape = shape.strip().lower()
    if shape not in ("ellipsoid", "sphere") or not colon:
        raise InvalidInput(f"fingertip: expected ellipsoid:A,B,Cmm or sphere:Rmm, got {text!r}")
    sizes, given = _split(rest)
    lengths = _lengths(",".join(sizes), shape, 3 if shape == "ellipsoid" else 1)
    options = _options(given)
    try:
        return Ellipsoid(lengths, **options) if shape == "ellipsoid" else Sphere(lengths[0], **options)
    except InvalidInput as error:
        raise InvalidInput(f"fingertip {text!r}: {error}") from None


def _split(rest: str) -> tuple[list[str], dict[str, str]]:
    """The sizes, and the options' values by name; a part without `=` belongs to what came before it."""
    sizes: list[str] = []
    given: dict[str, str] = {}
    last = ""
    for part in re.split("[,;]", rest):
        name, equals, value = part.partition("=")
        name = name.strip()
        if not equals and last:
            given[last] += f",{part}"
        elif not equals:
            sizes.append(part)
        elif name in given:
            raise InvalidInput(f"fingertip: expected {name} once, got it twice")
        else:
            last, given[name] = name, value
    return sizes, given


def _options(given: dict[str, str]) -> dict[str, Any]:
    """Arguments of a fingertip from the options' texts."""
    readers: dict[str, tuple[str, Callable[[str, str], object]]] = {
        "cap": ("cap", lambda value, name: _lengths(value, name, 1)[0]),
        "friction": ("max_friction", partial(_plain, unit="")),
        "min_force": ("min_force", partial(_plain, unit="N")),
        "sensor": ("T_surface_sensor", _sensor),
    }
    options = {}
    for name, value in given.items():
        if name not in readers:
            raise InvalidInput(f"fingertip: expected options {', '.join(readers)}, got {name!r}")
        field, read = readers[name]
        options[field] = read(value, name)
    return options


def _sensor(value: str, name: str) -> Array:
    """T_surface_sensor with parallel axes."""
    T_surface_sensor = np.eye(4)
    T_surface_sensor[:3, 3] = _lengths(value, name, 3)
    return T_surface_sensor


def _lengths(text: str, name: str, count: int) -> list[float]:
    """`count` lengths [m]; a unit after the last one counts for those without."""
    matches = [_NUMBER.fullmatch(part.strip()) for part in text.split(",")]
    numbers = [(float(match[1]), match[2]) for match in matches if match]
    if len(matches) != count or len(numbers) != count:
        wanted = "a length" if count == 1 else f"{count} lengths"
        example = "8,8,12mm" if count == 3 else "9mm"
        raise InvalidInput(f"fingertip: {name}: expected {wanted} such as {example}, got {text.strip()!r}")
    metres = []
    for value, unit in numbers:
        unit = unit or numbers[-1][1]
        if unit not in UNITS:
            what = f"the unit {unit!r}" if unit else "no unit"
            raise InvalidInput(f"fingertip: {name}: expected mm, cm or m in {text.strip()!r}, got {what}")
        metres.append(value * UNITS[unit])
    return metres


def _plain(text: str, name: str, unit: str) -> float:
    match = _NUMBER.fullmatch(text.strip())
    if not match or match[2] not in ("", unit):
        unit_hint = f" [{unit}]" if unit else ""
        raise InvalidInput(f"fingertip: {name}: expected a number{unit_hint}, got {text.strip()!r}")
    return float(match[1])
