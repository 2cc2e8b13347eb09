"""Old public names: each works for one release, with a warning that names the new one."""

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module


def renamed(module: str, names: Mapping[str, str], *, stacklevel: int = 2) -> Callable[[str], object]:
    """Returns the `__getattr__` of a module some of whose names were changed.

    `names` maps an old name to the full dotted path of the new one. Asking for an old name answers the new object and
    issues a DeprecationWarning; asking for any other raises AttributeError, as a module without `__getattr__` does.
    `stacklevel`: 2 where it is the module's `__getattr__`, 3 where that calls it.
    """

    def __getattr__(name: str) -> object:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        room, _, attribute = names[name].rpartition(".")
        message = f"{module}.{name} is now {names[name]}; the old name goes with the next release"
        warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)
        return getattr(import_module(room), attribute)

    return __getattr__
