"""Writes docs/licences.md: what `pip install handsight` with its extras brings, and under which licence.

Licences are read from the metadata of what is installed; `tests/test_licences.py` compares the page with it.
"""

import re
import tomllib
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "licences.md"
EXTRAS = ("robot", "sim", "vision", "plot", "cluster", "library", "view", "ros2", "docs")
"""In the page's order; those for development and benchmarks are not installed by users."""
LONGEST = 60
HEAD = """\
# Licences

handsight is under Apache-2.0. What it asks for directly, and each one's licence as its own metadata says
(`python docs/licences.py` writes this page):

<!-- no figures: versions -->
| package | asked for by | licence |
|---|---|---|
"""


def asked_for() -> dict[str, list[str]]:
    """By package: what asks for it, the core or an extra."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    wanted = {"core": project["dependencies"]} | {name: extras[name] for name in EXTRAS if name in extras}
    found: dict[str, list[str]] = {}
    for extra, requirements in wanted.items():
        for requirement in requirements:
            name = re.match(r"[\w.-]+", requirement)[0]
            if name != "handsight":
                found.setdefault(name, []).append(extra)
    return found


def licence(package: str) -> str | None:
    """What an installed package says of its licence in a few words; None where it is not installed."""
    try:
        said = metadata(package)
    except PackageNotFoundError:
        return None
    classified = [line.rpartition(" :: ")[2] for line in said.get_all("Classifier", []) if "License" in line]
    text = (said.get("License") or "").strip().partition("\n")[0]
    short = text if len(text) <= LONGEST else ""
    return said.get("License-Expression") or ", ".join(classified) or short or "see its files"


def known() -> dict[str, tuple[str, str]]:
    """By package: what the page says, who asks for it and its licence."""
    if not PAGE.exists():
        return {}
    rows = re.findall(r"^\| ([\w.-]+) \| (.+?) \| (.+?) \|$", PAGE.read_text(), re.MULTILINE)
    return {package: (by, said) for package, by, said in rows if package != "package"}


def main() -> None:
    """Writes the page; what is not installed here keeps what the page said of it."""
    rows = []
    for package, by in asked_for().items():
        said = licence(package) or known().get(package, ("", "not installed when this was written"))[1]
        rows.append(f"| {package} | {', '.join(by)} | {said} |")
    PAGE.write_text(HEAD + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()
