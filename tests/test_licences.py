"""The page of licences names every dependency, with who asks for it, and all are permissive."""

import re
import tomllib
from pathlib import Path

ROOT = Path(__file__).parents[1]
PERMISSIVE = ("MIT", "BSD", "APACHE", "PSF", "PYTHON SOFTWARE", "HPND", "ZLIB", "0BSD", "EPL")
NOT_FOR_USERS = ("all", "dev", "bench")


def test_every_dependency_is_on_the_page_with_who_asks_for_it():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = {"core": project["dependencies"], **project["optional-dependencies"]}
    asked = set()
    for extra, requirements in wanted.items():
        names = {re.match(r"[\w.-]+", requirement)[0] for requirement in requirements} - {"handsight"}
        asked |= {(name, extra) for name in names if extra not in NOT_FOR_USERS}
    rows = re.findall(
        r"^\| ([\w.-]+) \| (.+?) \| (.+?) \|$", (ROOT / "docs/licences.md").read_text(), re.MULTILINE
    )
    listed = {(name, extra) for name, extras, _ in rows[1:] for extra in extras.split(", ")}
    assert listed == asked
    for name, _, licence in rows[1:]:
        assert any(word in licence.upper() for word in PERMISSIVE), f"{name}: {licence}"
