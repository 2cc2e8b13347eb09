"""How tests and experiments ask for a refusal: by the error's type and the input that it names, not by its sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

from handsight.errors import HandsightError


@contextmanager
def refused(kind: type[HandsightError], field: str) -> Iterator[None]:
    """What is done inside is refused with an error of this type that names this input.

    A file is named by the last part of its path.
    """
    try:
        yield
    except HandsightError as error:
        named = error.field, error.field.rpartition("/")[2]
        if not isinstance(error, kind) or field not in named:
            expected = f"expected {kind.__name__} of {field!r}"
            raise AssertionError(
                f"{expected}, got {type(error).__name__} of {error.field!r}: {error}"
            ) from error
        return
    raise AssertionError(f"expected {kind.__name__} of {field!r}, got no error")
