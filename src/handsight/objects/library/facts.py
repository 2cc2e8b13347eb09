"""`handsight.json`, beside a BOP folder's `models_info.json`: what that has no room for, by the object's number."""

import re
from typing import NamedTuple

import msgspec

from handsight import checks
from handsight.errors import InvalidInput
from handsight.objects.files.read import LARGEST_FILE


class FactLimits(NamedTuple):
    """`FactLimits` are what a library says of an object."""

    version: int = 1  # of the file
    max_mass: float = 100.0  # of what a hand holds [kg]; beyond it the unit is wrong
    max_text: int = 500  # characters of a licence or a source


FACTS_LIMITS = FactLimits()

_NAME = re.compile(r"\w[\w .+-]*")
_NUMBERED = re.compile(r"\d+|obj_\d{6,}")
"""What objects without a name are called."""


class Facts(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A `Facts` is what is known of an object besides its surface; raises InvalidInput for what cannot be."""

    name: str
    """Letters, digits, blanks and `_.+-`, the first a letter or a digit, not all of them digits."""
    mass: float | None = None
    """[kg]"""
    center_of_mass: tuple[float, float, float] | None = None
    """In the object's frame [m]."""
    sigma_center_of_mass: float | None = None
    """One standard deviation per axis [m]."""
    licence: str = ""
    source: str = ""
    """Where the model is from."""

    def __post_init__(self) -> None:
        check_name(self.name)
        if self.mass is not None and checks.positive(self.mass, "mass") > FACTS_LIMITS.max_mass:
            raise InvalidInput(f"mass: expected kilograms, got {self.mass:g} (grams?)")
        if self.center_of_mass is not None:
            checks.in_reach(self.center_of_mass, "center_of_mass", (3,))
        if self.sigma_center_of_mass is not None:
            checks.sigma(self.sigma_center_of_mass, "sigma_center_of_mass")
            if self.center_of_mass is None:
                raise InvalidInput("sigma_center_of_mass: expected beside center_of_mass only, got it alone")
        for key in ("licence", "source"):
            _check_text(getattr(self, key), key)


class Record(Facts, frozen=True, kw_only=True, forbid_unknown_fields=True, omit_defaults=True):
    """A `Record` is the same with what its model's file must be."""

    sha256: str
    bytes: int

    def __post_init__(self) -> None:
        super().__post_init__()
        if not re.fullmatch(r"[0-9a-f]{64}", self.sha256):
            raise InvalidInput(f"sha256: expected 64 hexadecimal digits, got {checks.brief(self.sha256)}")
        checks.integer(self.bytes, "bytes", LARGEST_FILE)


class Document(msgspec.Struct, forbid_unknown_fields=True):
    """A `Document` is the file; keys of another version are that version's."""

    version: int
    objects: dict[str, Record]


def check_name(name: object) -> None:
    """Raises InvalidInput for what no object can be called: what a path or a terminal would obey, or a number."""
    message = f"expected up to {checks.MAX_NAME_LENGTH} letters, digits, blanks and _.+-, the first a letter or a digit"
    if not isinstance(name, str) or len(name) > checks.MAX_NAME_LENGTH or not _NAME.fullmatch(name):
        raise InvalidInput(f"name: {message}, got {checks.brief(name)!r}")
    if name != name.strip() or _NUMBERED.fullmatch(name):
        raise InvalidInput(f"name: expected no number and no blank at its end, got {name!r}")


def _check_text(value: object, key: str) -> None:
    if not isinstance(value, str) or len(value) > FACTS_LIMITS.max_text:
        raise InvalidInput(
            f"{key}: expected a text of up to {FACTS_LIMITS.max_text} characters, got {checks.brief(value)}"
        )
