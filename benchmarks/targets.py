"""What was promised, and what this run measured: times on two cores, taken in the run's own way."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

Results = dict[str, Any]
Read = Callable[[Results], float | None]
NEAR, FAR = "20 mm / 15°", "85 mm / 30°"


@dataclass(frozen=True)
class Target:
    """One promise."""

    what: str
    read: Read
    limit: float
    at_most: bool = True
    scale: float = 1.0
    unit: str = ""

    def row(self, results: Results) -> list[str]:
        """Returns a row: name, measured value, target, whether it is met."""
        sign = "≤" if self.at_most else "≥"
        wanted = f"{sign} {self.limit:g} {self.unit}"
        try:
            value = self.read(results)
        except (KeyError, StopIteration, TypeError, ValueError, ZeroDivisionError):
            value = None
        if value is None:
            return [self.what, "not measured", wanted, ""]
        value *= self.scale
        met = value <= self.limit if self.at_most else value >= self.limit
        return [self.what, f"{value:.3g} {self.unit}", wanted, "met" if met else "NOT met"]


def worst(peer: str, key: str, error: str = NEAR) -> Read:
    """Returns the larger value of can and box."""
    return lambda results: max(r[key] for r in _cases(results, peer, error))


def _cases(results: Results, peer: str, error: str) -> list[Results]:
    return [r for r in results["sections"]["correction"] if r["peer"] == peer and r["error"] == error]


def tail(results: Results) -> float:
    """Returns p99 over median, the larger of can and box."""
    return max(r["p99_s"] / r["median_s"] for r in _cases(results, "ours", NEAR))


def success_over(peer: str, object_name: str) -> Read:
    """Returns our success over a peer's on one object."""

    def read(results: Results) -> float:
        found = {r["peer"]: r["success"] for r in results["sections"]["correction"]
                 if r["error"] == NEAR and r["object"] == object_name}  # fmt: skip
        return float(found["ours"] / found[peer])

    return read


def times_faster(ratio: str) -> Read:
    """Returns the inverse of a ratio."""
    return lambda results: 1 / results["ratios"][ratio]["ratio"]


def ratio(name: str) -> Read:
    """Returns the number itself."""
    return lambda results: results["ratios"][name]["ratio"]


def of(section: str, name: str, key: str = "median_s") -> Read:
    """Returns a number of the row whose name begins with a text."""
    return lambda results: next(r[key] for r in results["sections"][section] if r["name"].startswith(name))


def slowest(section: str, name: str) -> Read:
    """Returns the largest median of the rows whose name begins with a text."""
    return lambda results: max(
        r["median_s"] for r in results["sections"][section] if r["name"].startswith(name)
    )


TARGETS = [
    Target("correct_pose, 20 mm start, median", worst("ours", "median_s"), 150, scale=1e6, unit="µs"),
    Target("  the same, repeated on one problem (hot)", worst("ours", "hot_median_s"), 45, scale=1e6, unit="µs"),
    Target("its kernel, median", worst("ours_kernel", "median_s"), 30, scale=1e6, unit="µs"),
    Target("correct_pose, p99 over median", tail, 4, unit="x"),
    Target("faster than the paper's method, compiled", times_faster("ours / paper"), 3, at_most=False, unit="x"),
    Target("  its kernel, the same", times_faster("ours_kernel / paper"), 10, at_most=False, unit="x"),
    Target("  success over the paper's, can", success_over("paper", "can"), 1, at_most=False, unit="x"),
    Target("  success over the paper's, box", success_over("paper", "box"), 1, at_most=False, unit="x"),
    Target("faster than small_gicp PLANE_ICP", times_faster("ours / small_gicp"), 2.5, at_most=False, unit="x"),
    Target("  its kernel, the same", times_faster("ours_kernel / small_gicp"), 2.5, at_most=False, unit="x"),
    Target("  success over small_gicp's, box", success_over("small_gicp", "box"), 2.5, at_most=False, unit="x"),
    Target("correct_pose, 85 mm start, median", worst("ours", "median_s", FAR), 1.2, scale=1e3, unit="ms"),
    Target("blind, five contacts with normals", slowest("blind", "handsight, blind"), 20, scale=1e3, unit="ms"),
    Target("blind, sixty without", slowest("blind", "handsight, 60"), 0.5, unit="s"),
    Target("correct_pose, 100 points of the hand over none", ratio("100 points of the hand / none"), 1.5, unit="x"),
    Target("descents", of("batch", "a descent of many", "per_second"), 400, at_most=False, scale=1e-3, unit="k/s"),
    Target("field query in batch, with curvature", of("closest", "handsight field"), 0.12, scale=1e6, unit="µs"),
    Target("import handsight", of("startup", "import"), 0.6, unit="s"),
    Target("handsight --help", of("startup", "handsight --help"), 0.5, unit="s"),
    Target("new process to first correction, warm", of("startup", "new process to first correction, warm"), 1.0,
           unit="s"),
    Target("  the same, nothing compiled", of("startup", "new process to first correction, nothing"), 45, unit="s"),
    Target("handsight locate of one image, warm", of("startup", "handsight locate of one image, warm"), 1.5, unit="s"),
    Target("  the same, with a picture", of("startup", "handsight locate of one image, warm, with"), 1.5, unit="s"),
    Target("handsight track to its first pose, warm", of("startup", "handsight track"), 2.0, unit="s"),
]  # fmt: skip


def rows(results: Results) -> list[list[str]]:
    """Returns a row for each promise."""
    return [target.row(results) for target in TARGETS]
