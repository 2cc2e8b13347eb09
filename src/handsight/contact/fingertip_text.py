"""Fingertips as a user types them: `ellipsoid:8,8,12mm,cap=-2mm,friction=1.2`."""

import re
from typing import Any

import numpy as np

from handsight import se3
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

_OPTIONS = {"cap": "cap", "friction": "max_friction", "min_force": "min_force", "sensor": "T_surface_sensor"}
_OPTION_BEGINS = re.compile(r"[,;](?=[^,;=]*=)")
_NUMBER = re.compile(r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)\s*([A-Za-z]*)")


def parse_fingertip(text: str) -> Fingertip:
    """The fingertip that `text` describes, in metres; the grammar is `FINGERTIP_HELP`.

    Raises InvalidInput that quotes the part at fault.
    """
    shape, colon, rest = text.partition(":")
    shape = shape.strip().lower()
    if shape not in ("ellipsoid", "sphere") or not colon:
        raise InvalidInput(f"fingertip: expected ellipsoid:A,B,Cmm or sphere:Rmm, got {text!r}")
    sizes, *given = _OPTION_BEGINS.split(rest)
    lengths = _lengths(sizes, shape, 3 if shape == "ellipsoid" else 1)
    options: dict[str, Any] = {}
    for name, _, value in (part.partition("=") for part in given):
        name = name.strip()
        if name not in _OPTIONS:
            raise InvalidInput(f"fingertip: expected options {', '.join(_OPTIONS)}, got {name!r}")
        if _OPTIONS[name] in options:
            raise InvalidInput(f"fingertip: expected {name} once, got it twice")
        options[_OPTIONS[name]] = _option(name, value)
    try:
        return Ellipsoid(lengths, **options) if shape == "ellipsoid" else Sphere(lengths[0], **options)
    except InvalidInput as error:
        raise InvalidInput(f"fingertip {text!r}: {error}") from None


def _option(name: str, text: str) -> Any:
    if name == "cap":
        return _lengths(text, name, 1)[0]
    if name == "sensor":
        return se3.compose(np.eye(3), np.array(_lengths(text, name, 3)))
    unit = "N" if name == "min_force" else ""
    match = _NUMBER.fullmatch(text.strip())
    if not match or match[2] not in ("", unit):
        hint = f" [{unit}]" if unit else ""
        raise InvalidInput(f"fingertip: {name}: expected a number{hint}, got {text.strip()!r}")
    return float(match[1])


def _lengths(text: str, name: str, count: int) -> list[float]:
    """`count` lengths [m]; a unit after the last one counts for those without."""
    text = text.strip()
    matches = [_NUMBER.fullmatch(part.strip()) for part in re.split("[,;]", text)]
    numbers = [(float(match[1]), match[2]) for match in matches if match]
    if len(matches) != count or len(numbers) != count:
        wanted = "a length such as 9mm" if count == 1 else f"{count} lengths such as 8,8,12mm"
        raise InvalidInput(f"fingertip: {name}: expected {wanted}, got {text!r}")
    units = [unit or numbers[-1][1] for _, unit in numbers]
    for unit in units:
        if unit not in UNITS:
            what = f"the unit {unit!r}" if unit else "no unit"
            raise InvalidInput(f"fingertip: {name}: expected mm, cm or m in {text!r}, got {what}")
    return [value * UNITS[unit] for (value, _), unit in zip(numbers, units, strict=True)]
