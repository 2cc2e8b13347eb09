"""The figures of the recordings, in README.md and docs/robots.md, from one file: docs/figures.json.

    python -m experiments.figures            # measures, writes docs/figures.json and the pages' lines (minutes)
    python -m experiments.figures --check    # measures what the first lines show, and compares: 1 if anything differs
    python -m experiments.figures --pages    # compares the pages with the file, without measuring

It simulates the can and the box as `handsight simulate` does (seed 0), and tracks them by `handsight
track` with each option of docs/robots.md; and it tracks the recordings that come with the package, as
`handsight demo` does. These were recorded once with the same seed; a simulation of today differs a
little. Errors are of the base's centre [mm]. Seconds of CPU are the machine's, and never compared. A
measured error may differ by 0.15 mm and a count by 2 %: processors round differently.
"""

import argparse
import json
import re
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import handsight

ROOT = Path(__file__).resolve().parent.parent
FILE = ROOT / "docs" / "figures.json"
OPTIONS = ("", "--rate 100", "--answer maximum", "--outside 0", "--outside 0 --answer maximum")
ERROR_TOLERANCE, COUNT_TOLERANCE = 0.15, 0.02
Figures = dict[str, Any]


def command(*words: object) -> float:
    """Runs `handsight`, and returns its CPU time [s]."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    subprocess.run(
        [Path(sys.executable).parent / "handsight", *map(str, words)], check=True, capture_output=True
    )
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def tracked(recording: Path, options: str) -> Figures:
    """What `handsight track` measures of a recording."""
    with tempfile.TemporaryDirectory() as folder:
        seconds = command("track", recording, "--output", Path(folder) / "out", *options.split())
        summary = json.loads((Path(folder) / "out" / "summary.json").read_text())
    vision, found = summary["errors_mm_deg"]["vision"], summary["errors_mm_deg"]["tracked"]
    keys = ("base_mean", "base_last", "middle_mean", "rotation_mean")
    return {
        "corrections": summary["corrections"],
        "vision": [round(vision[key], 2) for key in keys],
        "tracked": [round(found[key], 2) for key in keys],
        "cpu_s": round(seconds, 1),
    }


def measured(options: tuple[str, ...]) -> Figures:
    """All figures, with these options of `handsight track`."""
    data = Path(handsight.__file__).parent / "data"
    with tempfile.TemporaryDirectory() as folder:
        made = {name: Path(folder) / f"{name}.mcap" for name in ("can", "box")}
        for name, path in made.items():
            command("simulate", name, "--output", path)
        # The first ones compile what is not compiled yet, and their CPU time is not shown.
        packaged = {name: tracked(data / f"{name}.mcap", "") for name in made}
        simulated = {name: {each: tracked(path, each) for each in options} for name, path in made.items()}
    return {"simulated": simulated, "packaged": packaged}


def differences(before: Figures, now: Figures, at: str = "") -> list[str]:
    """Sentences about figures of `now` that are others in the file."""
    found = []
    for key, value in now.items():
        name, old = f"{at}/{key or 'no option'}", before[key]
        if isinstance(value, dict):
            found += differences(old, value, name)
        elif key != "cpu_s":
            far = COUNT_TOLERANCE * old if key == "corrections" else ERROR_TOLERANCE
            pairs = zip(old, value, strict=True) if isinstance(value, list) else [(old, value)]
            if any(abs(a - b) > far for a, b in pairs):
                found.append(f"{FILE.name}{name}: has {old}, measured {value}")
    return found


def lines(figures: Figures) -> dict[str, dict[str, str]]:
    """By page, patterns of its lines and what they must be."""
    can, box = (figures["simulated"][name] for name in ("can", "box"))
    ends = {
        f"{who}: base centre off by .*": "{}: base centre off by {:.1f} mm on average ({:.1f} at the end), middle "
        "{:.1f} mm, rotation {:.1f}°".format(who, *can[""][who])
        for who in ("vision", "tracked")
    }
    ends[r"1841 poses of 1841 observations, \d+ corrections"] = (
        f"1841 poses of 1841 observations, {can['']['corrections']} corrections"
    )
    table = {
        rf"\| {re.escape(f'`{each}`') if each else ''} ?\| \d+, .*": f"| {f'`{each}` ' if each else ''}| "
        + " | ".join(
            f"{one['corrections']}, {one['cpu_s']} s, {one['tracked'][0]:.1f} and {one['tracked'][1]:.1f} mm"
            for one in (can[each], box[each])
        )
        + " |"
        for each in OPTIONS
        if each in can
    }
    pack = {name: one["tracked"] for name, one in figures["packaged"].items()}
    older = "can {:.1f} mm and {:.1f} at the end, box {:.1f} and {:.1f}".format(
        *pack["can"][:2], *pack["box"][:2]
    )
    readme = f"vision {can['']['vision'][0]:.0f} mm off, tracked {can['']['tracked'][0]:.0f} mm (synthetic)"
    return {
        "docs/robots.md": ends
        | table
        | {r"can \d+\.\d mm and \d+\.\d at the end, box \d+\.\d and \d+\.\d": older},
        "README.md": {r"vision \d+ mm off, tracked \d+ mm \(synthetic\)": readme},
    }


def main() -> int:
    """Returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--pages", action="store_true")
    given = parser.parse_args()
    write = not (given.check or given.pages)
    figures = measured(OPTIONS) if write else json.loads(FILE.read_text())
    wrong = differences(figures, measured(("",))) if given.check else []
    if write:
        FILE.write_text(json.dumps(figures, indent=1) + "\n")
    for page, expected in lines(figures).items():
        text = (ROOT / page).read_text()
        for pattern, line in expected.items():
            found = re.findall(pattern, text)
            if len(found) != 1:
                wrong.append(f"{page}: expected one line like {pattern!r}, got {len(found)}")
            elif write:
                text = text.replace(found[0], line)
            elif found[0] != line:
                wrong.append(f"{page}: expected {line!r}, got {found[0]!r}")
        if write:
            (ROOT / page).write_text(text)
    print("\n".join(wrong) or "the figures of the recordings agree")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
