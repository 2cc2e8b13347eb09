"""What can be wrong with an input. Each message names the argument, what was expected and what came."""


class HandsightError(Exception):
    """Any input that handsight refuses; catch this to catch them all."""


class InvalidInput(HandsightError, ValueError):
    """An argument has the wrong shape, unit, range or is not finite."""


class InvalidTransform(InvalidInput):
    """A 4 x 4 array is not a rigid transform."""


class InvalidObject(HandsightError, ValueError):
    """A mesh, a cloud or a size from which no object model can be made."""


class InvalidFile(HandsightError, ValueError):
    """A file that cannot be read as what it should be; the message starts with its name."""


class MissingExtra(HandsightError, ImportError):
    """An optional dependency is not installed; the message says which `pip install` brings it."""
