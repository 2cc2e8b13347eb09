"""How far off the tracked pose of a recording is: a Markdown table, for docs/robots.md.

    python -m experiments.recordings            # simulated as `handsight simulate` does (seed 0), and of the package
    python -m experiments.recordings --options  # the simulated ones, with each option of docs/robots.md (minutes)

Recordings are tracked by `handsight track`. Those of the package, which `handsight demo` tracks, were recorded once
with the same seed; a simulation of today differs a little. Errors are of the base's centre (synthetic).
"""

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import handsight

OPTIONS = ("", "--rate 100", "--answer maximum", "--outside 0", "--outside 0 --answer maximum")
OBJECTS = ("can", "box")


def command(*words: object) -> float:
    """Runs `handsight`, and returns its CPU time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [Path(sys.executable).parent / "handsight", *map(str, words)], check=True, capture_output=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tracked(recording: Path, options: str = "") -> tuple[dict[str, Any], float]:
    """Returns what `handsight track` writes of a recording, and its CPU time [s]."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = command("track", recording, "--output", Path(folder) / "out", *options.split())
        return json.loads((Path(folder) / "out" / "summary.json").read_text()), seconds


def print_row(*cells: str) -> None:
    """Prints a row of a Markdown table."""
    print("|", " | ".join(cells), "|", flush=True)


def print_options(made: dict[str, Path]) -> None:
    """Prints the table of the options."""
    print_row("option", *(f"{name}: corrections, CPU, mean and last error" for name in made))
    print_row("---", "---", "---")
    for options in OPTIONS:
        cells = [f"`{options}`" if options else "none"]
        for recording in made.values():
            summary, seconds = tracked(recording, options)
            errors = summary["errors_mm_deg"]["tracked"]
            error = "{base_mean:.1f} and {base_last:.1f} mm".format(**errors)
            cells.append(f"{summary['corrections']}, {seconds:.1f} s, {error}")
        print_row(*cells)


def print_recordings(recordings: dict[str, Path]) -> None:
    """Prints the table of the recordings."""
    print_row("recording", "corrections", "of", "mean mm", "last mm", "middle mm", "rotation °")
    print_row(*7 * ["---"])
    for name, recording in recordings.items():
        summary, _ = tracked(recording)
        for who, errors in summary["errors_mm_deg"].items():
            if who in ("vision", "tracked"):
                keys = ("base_mean", "base_last", "middle_mean", "rotation_mean")
                numbers = (f"{errors[key]:.2f}" for key in keys)
                print_row(name, str(summary["corrections"]) if who == "tracked" else "", who, *numbers)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--options", action="store_true")
    options = parser.parse_args().options
    with tempfile.TemporaryDirectory() as folder:
        made = {name: Path(folder) / f"{name}.mcap" for name in OBJECTS}
        for name, path in made.items():
            command("simulate", name, "--output", path)
        if options:
            tracked(made["can"])  # compiles what is not compiled yet
            print_options(made)
            return
        data = Path(handsight.__file__).parent / "data"
        simulated = {f"{name}, simulated": path for name, path in made.items()}
        print_recordings(simulated | {f"{name}, of the package": data / f"{name}.mcap" for name in OBJECTS})


if __name__ == "__main__":
    main()
