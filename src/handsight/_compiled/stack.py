"""Records on the stack. Numba makes arrays on the heap only, and frees one while a record of it is still in use."""

from typing import Any

from numba.extending import intrinsic


@intrinsic
def local(_: Any, dtype: Any) -> Any:
    """Returns a record of a type on the stack, not initialised; it is valid until the calling kernel returns."""
    return dtype.dtype(dtype), _local


def _local(context: Any, builder: Any, signature: Any, _: Any) -> Any:
    """Reserves one piece of memory for each call in the source, however often it runs."""
    pointer = context.get_value_type(signature.return_type)
    with builder.goto_entry_block():
        place = builder.alloca(pointer.pointee)
        place.align = 32
    return place
