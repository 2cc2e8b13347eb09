"""The parts of the corpus: doors, cases, the outcomes that are allowed, and functions that corrupt valid input.

A door is a public function, a command or the reader of a file. It gets valid input that a random generator corrupts; a
case is an input that once failed. A door may answer, or refuse with a HandsightError. Anything else is a fault: another
exception, a number that is not finite, a covariance that is not positive semidefinite, more than `SECONDS` for one
input.
"""

import contextlib
import math
import random
import signal
import struct
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from handsight.errors import HandsightError

SECONDS = 20
"""The longest time for one input; most take milliseconds, and more on a busy machine."""


@dataclass(frozen=True)
class Door:
    """A place where input enters handsight."""

    name: str
    bring: Callable[[random.Random], None]
    """Corrupts one input by the given generator and passes it to the door; raises the errors of the door, and asserts
    what must hold for an answer."""
    inputs: int
    """How many inputs the tests try."""


@dataclass(frozen=True)
class Case:
    """An input that once caused a fault."""

    name: str
    bring: Callable[[], None]
    says: str | None
    """Part of the HandsightError's message; None: the input must be answered."""


class Fault(AssertionError):
    """The error that a door neither answered nor refused."""


def knock(door: Door, seed: int) -> bool:
    """Returns whether a door answered one input; raises Fault for anything but an answer or a refusal."""
    try:
        with within(SECONDS), warnings.catch_warnings():
            warnings.simplefilter("ignore")
            door.bring(random.Random(f"{door.name} {seed}"))
    except HandsightError as error:
        check_sentence(str(error))
        return False
    except Exception as error:
        raise Fault(f"{door.name}, seed {seed}: {type(error).__name__}: {error}") from error
    return True


def check_sentence(message: str) -> None:
    """Asserts that a message is one line for a person, without control characters, and of bounded length."""
    assert message, "an empty message"
    assert len(message) < 2000, f"a message of {len(message)} characters"
    assert message.isprintable(), f"a message with control characters: {message!r}"
    assert "fault of handsight" not in message, message
    assert " object at 0x" not in message, message


@contextlib.contextmanager
def within(seconds: int) -> Iterator[None]:
    """Raises Fault where the work inside takes longer; does nothing on systems without alarms."""

    def late(signum: int, frame: object) -> None:
        raise Fault(f"took longer than {seconds} s")

    if not hasattr(signal, "SIGALRM"):
        yield
        return
    before = signal.signal(signal.SIGALRM, late)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def check_covariance(covariance: np.ndarray | None) -> None:
    """Asserts that a covariance is None, or finite, symmetric and positive semidefinite, to rounding in its own units."""
    if covariance is None:
        return
    assert np.isfinite(covariance).all(), f"covariance: {covariance}"
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0))
    scale = np.where(deviation > 0, deviation, 1.0)
    normalised = covariance / scale[:, None] / scale
    np.testing.assert_allclose(normalised, normalised.T, atol=1e-6)
    assert np.linalg.eigvalsh((normalised + normalised.T) / 2).min() > -1e-6, f"covariance: {covariance}"


def check_pose(T: np.ndarray) -> None:
    """Asserts that `T` is a finite rigid transform."""
    assert np.isfinite(T).all(), f"pose: {T}"
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-5)
    assert np.linalg.det(T[:3, :3]) > 0


NUMBERS: list[object] = [
    *(0.0, -0.0, 1.0, -1.0, 1e-9, 1e-200, 5e-324, 1e5, 1e20, 1e155, 1e200, 1.7e308, -1e160, 1000.0),
    *(math.nan, math.inf, -math.inf, 2**53, 2**63, 2**64, -(2**63) - 1, 10**400),
]
STRANGE: list[object] = [
    *NUMBERS,
    *(None, True, "", "1", "nan", "a" * 10_000, "\x1b[31mred\n", "\ud800", "\ufeff", b"\x00", [], {}, [[]]),
    *([0.0], [1.0, 2.0], [0.0] * 3, [math.nan] * 3, [[1.0, 2.0, 3.0], [1.0]], ["1", "2", "3"], {"x": 1}),
]
"""Values that replace a valid one."""


def spoilt_value(value: object, rng: random.Random) -> object:
    """Returns a JSON value with one part of it changed: replaced, dropped, repeated, or scaled as by another unit."""
    if isinstance(value, dict) and value and rng.random() < 0.9:
        changed = dict(value)
        key = rng.choice(sorted(changed))
        if rng.random() < 0.1:
            del changed[key]
        elif rng.random() < 0.1:
            changed[rng.choice(["x", "", "\x1b[2J", key + "s", "__class__"])] = rng.choice(STRANGE)
        else:
            changed[key] = spoilt_value(changed[key], rng)
        return changed
    if isinstance(value, list) and value and rng.random() < 0.9:
        rows = list(value)
        i = rng.randrange(len(rows))
        if rng.random() < 0.1:
            del rows[i]
        elif rng.random() < 0.1:
            rows[i:i] = [rows[i]] * rng.choice([1, 2, 50])
        else:
            rows[i] = spoilt_value(rows[i], rng)
        return rows
    if isinstance(value, float) and rng.random() < 0.5:
        return value * rng.choice([1e3, 1e-3, 57.29578, -1.0, 1e20, 1e160, 1e-160, 0.0])
    return rng.choice(STRANGE)


def spoilt_bytes(data: bytes, rng: random.Random) -> bytes:
    """Returns bytes that were cut, flipped, repeated or replaced, some by a number where a count may be."""
    for _ in range(rng.choice([1, 1, 2, 8])):
        at, end = sorted(rng.randrange(len(data) + 1) for _ in range(2))
        kind = rng.randrange(6)
        if kind == 0:
            data = data[:at]
        elif kind == 1 and data:
            at = rng.randrange(len(data))
            data = data[:at] + bytes([data[at] ^ (1 << rng.randrange(8))]) + data[at + 1 :]
        elif kind == 2:
            data = data[:at] + data[at : at + 64] * rng.choice([2, 3, 100]) + data[at + 64 :]
        elif kind == 3:
            size = rng.choice([1, 4, 8])
            number = rng.choice([0, 1, 0x7F, 0xFF, 2**31 - 1, 2**31, 2**32 - 1, 2**63, 2**64 - 1])
            data = data[:at] + struct.pack("<Q", number)[:size] + data[at + size :]
        elif kind == 4:
            data = data[:at] + data[end:]
        else:
            data = data[:at] + rng.randbytes(rng.choice([1, 16, 256])) + data[at:]
    return data


WORDS = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e999",
    "1e20",
    "",
    "x",
    '"',
    "\x00",
    "\ufeff",
    "\x1b[31m",
    "9" * 400,
    "-",
    "[",
    "]",
]


def spoilt_text(text: str, rng: random.Random) -> str:
    """Returns text with a word replaced, a line dropped or repeated, or characters inserted."""
    for _ in range(rng.choice([1, 1, 2, 4])):
        lines = text.split("\n")
        i = rng.randrange(len(lines))
        words = lines[i].split(" ")
        kind = rng.randrange(4)
        if kind == 0:
            words[rng.randrange(len(words))] = rng.choice(WORDS)
            lines[i] = " ".join(words)
        elif kind == 1:
            del lines[i]
        elif kind == 2:
            lines.insert(i, lines[rng.randrange(len(lines))])
        else:
            at = rng.randrange(len(lines[i]) + 1)
            lines[i] = lines[i][:at] + rng.choice(WORDS) + lines[i][at:]
        text = "\n".join(lines)
    return text
