"""Former public names: each works for one release, with a warning that names the new one."""

import warnings
from collections.abc import Callable, Mapping
from importlib import import_module


def renamed(module: str, names: Mapping[str, str], *, stacklevel: int = 2) -> Callable[[str], object]:
    """Returns a `__getattr__` for a module with renamed names.

    `names`: the full dotted path of the new name, by the old one. For an old name the `__getattr__` returns the new
    object and issues a DeprecationWarning; for any other it raises AttributeError. `stacklevel`: 2 if it is itself the
    module's `__getattr__`, 3 if the module's `__getattr__` calls it.
    """

    def __getattr__(name: str) -> object:
        if name not in names:
            raise AttributeError(f"module {module!r} has no attribute {name!r}")
        room, _, attribute = names[name].rpartition(".")
        message = f"{module}.{name} is now {names[name]}; the old name goes with the next release"
        warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)
        return getattr(import_module(room), attribute)

    return __getattr__
