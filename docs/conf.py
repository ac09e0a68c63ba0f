"""Sphinx: how the site is built."""

import taut

project = "taut"
author = "the taut maintainers"
release = taut.__version__
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.mathjax"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
html_theme = "furo"
html_title = "taut"
exclude_patterns = ["_build"]
autodoc_typehints = "none"
autodoc_member_order = "bysource"
autodoc_class_signature = "separated"
napoleon_google_docstring = True
napoleon_custom_sections = [("Law", "notes_style"), "Closed loop", "Frames", "Model"]
mathjax_path = "mathjax-is-not-loaded.js"  # formulas are written as text; no page asks another host for anything
