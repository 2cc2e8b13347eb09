"""Former public names: each works for one release, with a warning that names the new one."""

import functools
import warnings
from collections.abc import Callable, Mapping
from importlib import import_module
from operator import attrgetter
from typing import Any, TypeVar, cast

T = TypeVar("T")
F = TypeVar("F", bound=Callable[..., Any])


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
        _warn(f"{module}.{name}", names[name], stacklevel=stacklevel + 1)
        return getattr(import_module(room), attribute)

    return __getattr__


def renamed_members(**names: str) -> Callable[[type[T]], type[T]]:
    """Returns a class decorator under which former names of attributes still work.

    `names` maps an old name to the new one, which may be dotted. Each use issues a DeprecationWarning; a type checker
    knows only the new names.
    """

    def decorate(cls: type[T]) -> type[T]:
        def __getattr__(self: T, name: str) -> object:
            if name not in names:
                raise AttributeError(f"{type(self).__name__!r} object has no attribute {name!r}")
            _warn(f"{cls.__name__}.{name}", f"{cls.__name__}.{names[name]}", stacklevel=3)
            return attrgetter(names[name])(self)

        setattr(cls, "__getattr__", __getattr__)  # noqa: B010 - a plain assignment lets mypy accept any attribute
        return cls

    return decorate


def renamed_arguments(*order: str, second: type | tuple[()] = (), **names: str) -> Callable[[F], F]:
    """Returns a decorator under which former names of a function's keywords, and a former order, still work.

    `names` maps an old name to the new one. `order`: the names of the first arguments in their former order, in which
    the second one was of the type `second`. Each use issues a DeprecationWarning.
    """

    def decorate(function: F) -> F:
        new_order = ", ".join(function.__code__.co_varnames[: len(order)])

        @functools.wraps(function)
        def call(*args: object, **keywords: object) -> object:
            name = function.__qualname__
            if len(args) > 1 and isinstance(args[1], second):
                _warn(f"{name}({', '.join(order)})", f"{name}({new_order})", stacklevel=3)
                args, keywords = (), dict(zip(order, args, strict=False)) | keywords
            for old, new in names.items():
                if old in keywords:
                    _warn(f"{name}({old}=)", f"{name}({new}=)", stacklevel=3)
                    keywords[new] = keywords.pop(old)
            return function(*args, **keywords)

        return cast(F, call)

    return decorate


def _warn(old: str, new: str, *, stacklevel: int) -> None:
    """Issues the warning about a former name; `stacklevel` 2 is the caller of this function."""
    message = f"{old} is now {new}; the old name goes with the next release"
    warnings.warn(message, DeprecationWarning, stacklevel=stacklevel)
