"""Search for the files that a robot's description names."""

import contextlib
import os
from importlib.util import find_spec
from pathlib import Path

from handsight.errors import InvalidFile

PACKAGE = "package://"


def find_file(name: str | Path, beside: str | Path = ".") -> Path:
    """Returns the file that a path or `package://NAME/rest` names in a file of the folder `beside`.

    NAME is the folder of a ROS package (in `beside`, its parents and their subfolders, $ROS_PACKAGE_PATH,
    $AMENT_PREFIX_PATH) or an installed Python package, which is not imported. Raises InvalidFile if there is none.
    """
    text = str(name)
    if not text.startswith(PACKAGE):
        path = Path(beside) / text.removeprefix("file://")
        if os.path.isfile(path):  # unlike Path.is_file, False for a text that is no name
            return path
        came = "a folder" if os.path.isdir(path) else "none of that name"
        raise InvalidFile(f"{text}: expected a file, got {came}")
    package, _, rest = text.removeprefix(PACKAGE).partition("/")
    folders, above = list[Path](), Path(beside).absolute()
    if package not in ("", ".", ".."):
        parents = [above, *above.parents]
        roots = [Path(p) for p in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if p]
        shares = [Path(p) / "share" for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
        folders = [folder for folder in [*parents, *roots] if folder.name == package]
        folders += [folder / package for folder in [*parents, *roots, *shares]]
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
