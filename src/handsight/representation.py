"""Short representations of values with large arrays: a few lines in a terminal, whatever their size."""

import dataclasses
from collections.abc import Mapping

import numpy as np

MAX_ITEMS = 3
"""An array or a sequence with more items on an axis is shown by its shape."""
MAX_CHARACTERS = 600


def short_repr(value: object) -> str:
    """Returns `Name(field=value, ...)` for a dataclass, to serve as its `__repr__`.

    A pose (4, 4) is shown as position [m] and angle of rotation, any other large array as its shape. Fields that have
    their default value are left out.
    """
    parts = [
        f"{field.name}={_shown(getattr(value, field.name))}"
        for field in dataclasses.fields(value)  # type: ignore[arg-type]
        if field.repr and field.name != "record" and not _is_default(field, getattr(value, field.name))
    ]
    text = f"{type(value).__name__}({', '.join(parts)})"
    return text if len(text) <= MAX_CHARACTERS else f"{text[: MAX_CHARACTERS - 4]}...)"


def _is_default(field: "dataclasses.Field[object]", value: object) -> bool:
    if field.default_factory is not dataclasses.MISSING:
        return isinstance(value, Mapping | tuple | list) and len(value) == 0
    return field.default is None and value is None


def _shown(value: object) -> str:
    if isinstance(value, np.ndarray):
        if value.dtype.names or value.ndim > 1 or value.size > MAX_ITEMS:
            if value.shape == (4, 4) and np.isfinite(value.astype(float)).all():
                angle = np.rad2deg(np.arccos(np.clip((np.trace(value[:3, :3]) - 1) / 2, -1, 1)))
                return f"<{_shown(value[:3, 3])} m, turned {angle:.3g}°>"
            return f"<{' × '.join(map(str, value.shape))}>"
        return f"[{' '.join(f'{x:.4g}' for x in value)}]" if value.ndim else f"{value:.4g}"
    if isinstance(value, Mapping):
        if len(value) > MAX_ITEMS:
            return f"<{len(value)}: {', '.join(map(str, list(value)[:MAX_ITEMS]))}, ...>"
        return "{" + ", ".join(f"{key!r}: {_shown(entry)}" for key, entry in value.items()) + "}"
    if isinstance(value, tuple | list):
        if len(value) > MAX_ITEMS:
            return f"<{len(value)}>"
        text = ", ".join(map(_shown, value))
        return f"({text})" if isinstance(value, tuple) else f"[{text}]"
    if isinstance(value, np.generic):
        return str(value.item())
    if isinstance(value, float):
        return f"{value:.6g}"
    return repr(value)
