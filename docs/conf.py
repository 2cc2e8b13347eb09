"""The manual: `make docs` builds it into build/manual; a warning is an error, and nothing is fetched."""

import re
from importlib.metadata import version as installed_version

project = "handsight"
author = "The handsight authors"
project_copyright = "The handsight authors; Apache-2.0"
version = release = installed_version("handsight")

extensions = ["myst_parser", "sphinx.ext.autodoc"]
exclude_patterns = ["_build", "generated"]  # pages include the tables of generated/

html_theme = "furo"
html_title = f"handsight {release}"
html_copy_source = html_show_sphinx = False
html_static_path = ["_static"]
html_css_files = ["manual.css"]

myst_heading_anchors = 4

# Types stand in the signatures' sources; in docstrings each shape and unit is said in words.
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "mixed"
autodoc_default_options = {"members": True}

_MARKUP = re.compile(r"``.+?``|`.+?`|[*|_](?=\S)|(?<=\w)_", re.DOTALL)


def _plain(_app, _what, _name, _object, _options, lines: list[str]) -> None:
    """Docstrings are plain text with `code` in it: what reST would read as markup stands as it is."""

    def told(match: re.Match[str]) -> str:
        found = match[0]
        if found.startswith("``"):
            return found
        return f"``{found[1:-1]}``" if found.startswith("`") else f"\\{found}"

    lines[:] = _MARKUP.sub(told, "\n".join(lines)).split("\n")


def setup(app) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", _plain)
