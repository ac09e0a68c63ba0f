"""Sphinx: how the site is built."""

import importlib
import inspect
import tomllib
from importlib import resources
from typing import Any, ClassVar

from docutils import nodes
from docutils.statemachine import StringList
from sphinx.util.docutils import SphinxDirective

import taut

project = "taut"
author = "the taut maintainers"
release = taut.__version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx-mathjax-offline",  # MathJax itself, so that a page needs no network
    "sphinx_design",
]
myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "taut"
html_static_path = ["static"]
html_css_files = ["site.css"]
exclude_patterns = ["_build"]
suppress_warnings = ["myst.header"]  # the front page takes a section of the README
autodoc_typehints = "none"
autodoc_member_order = "bysource"
napoleon_google_docstring = True
napoleon_custom_sections = ["Frames", "Model"]
EQUATIONS = ("Law:", "Closed loop:", "Model:", "Action:")


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


class PublicNames(SphinxDirective):
    """`public-names:: taut.laws`: every public name of a module, as its own list of names has them.

    Methods of laws and errors are not shown: those of a law are the library's business, and an error has none.
    """

    required_arguments = 1
    shown: ClassVar[dict[int, str]] = {}

    def run(self) -> list[nodes.Node]:
        module = importlib.import_module(self.arguments[0])
        lines = []
        for name in module.__all__:
            thing = getattr(module, name)
            elsewhere = module is taut and (name in taut.laws.__all__ or name in taut.errors.__all__)
            if inspect.ismodule(thing) or elsewhere:
                continue
            if callable(thing) and self.shown.setdefault(id(thing), module.__name__) != module.__name__:
                continue  # a name of two modules is shown in one of them
            kind = "autoclass" if inspect.isclass(thing) else "autofunction" if callable(thing) else "py:data"
            lines.append(f".. {kind}:: {module.__name__}.{name}")
            if kind == "autoclass" and not issubclass(thing, Exception) and module is not taut.laws:
                lines.append("   :members:")
            lines.append("")
        node = nodes.section()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, source=module.__name__), self.content_offset, node)
        return node.children


class Gallery(SphinxDirective):
    """`gallery::` shows a card for each built-in scenario: picture, title, and the command that runs it."""

    def run(self) -> list[nodes.Node]:
        lines = [".. grid:: 1 2 2 3", "   :gutter: 3", ""]
        for file in sorted((resources.files("taut.scenarios") / "files").iterdir(), key=lambda file: file.name):
            name, _, kind = file.name.rpartition(".")
            if kind != "toml":
                continue
            title = tomllib.loads(file.read_text(encoding="utf-8"))["title"]
            lines += [f"   .. grid-item-card:: {name}", f"      :img-top: images/{name}.png", ""]
            lines += [f"      {title}", "", f"      ``taut run {name}``", ""]
        node = nodes.section()
        node.document = self.state.document
        self.state.nested_parse(StringList(lines, source="gallery"), self.content_offset, node)
        return node.children


def setup(app: Any) -> None:
    """Called by Sphinx."""
    app.add_directive("public-names", PublicNames)
    app.add_directive("gallery", Gallery)
    app.connect("autodoc-process-docstring", keep_equations, priority=1)
