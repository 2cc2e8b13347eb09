"""Search for the files that a robot's description names."""

import contextlib
import os
import re
from importlib.util import find_spec
from pathlib import Path
from urllib.parse import unquote

from handsight.errors import HandsightError, InvalidFile
from handsight.files import read_bytes

PACKAGE = "package://"
MODEL = "model://"
MAX_MANIFEST = 1 << 20
"""Bytes of a `package.xml`."""


def find_file(name: str | Path, beside: str | Path = ".") -> Path:
    """Returns the file that a file of the folder `beside` names by a path, `file://`, `package://NAME/rest` or
    `model://NAME/rest`.

    NAME is the name in a `package.xml` above, the folder of a ROS package (in `beside`, its parents and their
    subfolders, $ROS_PACKAGE_PATH, $AMENT_PREFIX_PATH) or of a model of Gazebo (there, or in $GZ_SIM_RESOURCE_PATH,
    $GAZEBO_MODEL_PATH), or an installed Python package, which is not imported. Raises InvalidFile if there is none.
    """
    text = str(name)
    if not text.startswith((PACKAGE, MODEL)):
        path = Path(beside) / (unquote(text[7:]) if text.startswith("file://") else text)
        if os.path.isfile(path):  # unlike Path.is_file, False for a text that is no name
            return path
        came = "a folder" if os.path.isdir(path) else "none of that name"
        raise InvalidFile(f"{text}: expected a file, got {came}")
    package, _, rest = text.removeprefix(PACKAGE).removeprefix(MODEL).partition("/")
    folders = list[Path]()
    above = Path(beside).absolute()
    if package not in ("", ".", ".."):
        roots = _folders("ROS_PACKAGE_PATH")
        shares = [folder / "share" for folder in _folders("AMENT_PREFIX_PATH")]
        models = _folders("GZ_SIM_RESOURCE_PATH") + _folders("GAZEBO_MODEL_PATH")
        # A root may be the folder of the package.
        roots = [above, *above.parents, *(root.parent for root in roots), *roots, *shares, *models]
        named = [folder for folder in (above, *above.parents) if _package_name(folder) == package]
        folders = [*named, *(root / package for root in roots)]
    if package.isidentifier():  # a dotted name would import its parents
        with contextlib.suppress(ValueError):  # a module that runs as a script has no spec
            spec = find_spec(package)
            folders += [Path(p) for p in (spec and spec.submodule_search_locations) or ()]
    for folder in folders:
        if os.path.isfile(folder / rest):
            return folder / rest
    if any(os.path.isdir(folder) for folder in folders):
        raise InvalidFile(f"{text}: expected a file of the package, got none of that name")
    raise InvalidFile(
        f"{text}: expected a package in a folder above the file that names it, in $ROS_PACKAGE_PATH or "
        f"$AMENT_PREFIX_PATH, or installed in Python, got none called {package!r}"
    )


def _folders(variable: str) -> list[Path]:
    """Returns the folders in an environment variable."""
    return [Path(folder) for folder in os.environ.get(variable, "").split(os.pathsep) if folder]


def _package_name(folder: Path) -> str | None:
    """Returns the name in a folder's `package.xml`, whatever the folder is called; None where it has none."""
    if not os.path.isfile(folder / "package.xml"):
        return None
    try:
        text = read_bytes(folder / "package.xml", MAX_MANIFEST).decode(errors="replace")
    except HandsightError:
        return None
    found = re.search(r"<name>\s*([^<]*?)\s*</name>", text)
    return found[1] if found else None
