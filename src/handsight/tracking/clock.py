"""The time between two stamps."""


def seconds(now: float, then: float) -> float:
    """Returns the time between two stamps [s], to the microsecond.

    Stamps that count from 1970 are rounded to a quarter of one: so a recording is answered alike whenever it was made.
    """
    return round(now - then, 6)
