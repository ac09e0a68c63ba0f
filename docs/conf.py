"""Sphinx: how the site is built."""

from typing import Any

import taut

project = "taut"
author = "the taut maintainers"
release = taut.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "taut"
exclude_patterns = ["_build"]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_custom_sections = ["Frames", "Model"]
EQUATIONS = ("Law:", "Closed loop:", "Model:")


def keep_equations(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """The lines of a law's equation and closed loop stand as they are written, in columns."""
    out: list[str] = []
    inside = False
    for line in lines:
        if not inside and line.startswith(EQUATIONS):
            out += ["::", ""]
            inside = True
        if inside and not line.strip():
            inside = False
        out.append(f"   {line}" if inside else line)
    lines[:] = out


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.connect("autodoc-process-docstring", keep_equations, priority=1)
