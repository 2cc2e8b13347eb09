"""Short representations of values with large arrays: a few lines in a terminal, whatever their size."""

import dataclasses
from collections.abc import Mapping, Sized

import numpy as np

MAX_ITEMS = 3
"""An array or a sequence with more items is shown by its shape or its length."""
MAX_CHARACTERS = 600


def short_repr(value: object) -> str:
    """Returns `Name(field=value, ...)` for a dataclass, to serve as its `__repr__`.

    A pose (4, 4) is shown as position [m] and angle of rotation, any other large array as its shape. Fields that are
    None or empty are left out.
    """
    parts = []
    for field in dataclasses.fields(value):  # type: ignore[arg-type]
        item = getattr(value, field.name)
        is_empty = item is None or (isinstance(item, Sized) and not len(item))
        if field.repr and field.name != "record" and not is_empty:
            parts.append(f"{field.name}={_shown(item)}")
    text = f"{type(value).__name__}({', '.join(parts)})"
    return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 4]}...)"


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        if value.shape == (4, 4) and np.isfinite(value).all():
            angle = np.rad2deg(np.arccos(np.clip((np.trace(value[:3, :3]) - 1) / 2, -1, 1)))
            return f"<{_shown(value[:3, 3].tolist())} m, turned {angle:.3g}°>"
        if value.dtype.names or value.size > MAX_ITEMS:
            return f"<{' × '.join(map(str, value.shape))}>"
        return _shown(value.tolist())
    if isinstance(value, Mapping) or (isinstance(value, tuple | list) and len(value) > MAX_ITEMS):
        return f"<{len(value)}>"
    if isinstance(value, tuple | list):
        return f"[{', '.join(map(_shown, value))}]"
    return f"{value:.4g}" if isinstance(value, float) else repr(value)
