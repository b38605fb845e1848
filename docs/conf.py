"""Configuration of the documentation; ``scripts/build_docs`` builds it with warnings as errors."""

from __future__ import annotations

import inspect
import sys
from pathlib import Path
from typing import Any

import rmesh_nlp

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / "scripts" / "gallery"))

project = "rmesh_nlp"
author = "the authors of rmesh_nlp"
version = release = rmesh_nlp.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.mathjax",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
]
exclude_patterns = [
    "_build",
    "notes/*",
    "tutorials/*",
    "_templates/*",
    "sg_execution_times.rst",
    "gallery/sg_execution_times.rst",
]
templates_path = ["_templates"]
html_theme = "pydata_sphinx_theme"
html_title = "rmesh_nlp"
html_theme_options = {
    "show_toc_level": 2,
    "navigation_with_keys": False,
    "secondary_sidebar_items": ["page-toc"],
    "header_links_before_dropdown": 5,
}
html_show_sourcelink = False
html_sidebars = {name: [] for name in ("index", "getting_started", "theory")}

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]

autosummary_generate = True
autosummary_imported_members = False
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"  # a type without a meaning helps nobody
autodoc_member_order = "bysource"
napoleon_google_docstring = False
napoleon_use_ivar = True


def add_inherited_fields(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Append the ``Attributes`` of base classes: a reader of a class sees the meaning of every field."""
    if what != "class":
        return
    for base in obj.__mro__[1:]:
        text = inspect.getdoc(base) if base.__module__.startswith(("rmesh_nlp", "formulations")) else ""
        _, heading, fields = (text or "").partition("Attributes\n----------\n")
        if heading and "".join(fields.split()) not in "".join("".join(lines).split()):
            lines.extend(["", *heading.splitlines(), *fields.split("\n\n")[0].splitlines(), ""])


def setup(app: Any) -> None:
    """Register the hook above."""
    app.connect("autodoc-process-docstring", add_inherited_fields, priority=400)


sphinx_gallery_conf = {
    "examples_dirs": [str(ROOT / "docs" / "tutorials")],
    "gallery_dirs": ["gallery"],
    "filename_pattern": r"/tutorial_",
    "within_subsection_order": "FileNameSortKey",
    "download_all_examples": False,
    "remove_config_comments": True,
    "abort_on_example_error": True,
    "show_memory": False,
    "min_reported_time": 1e9,
}
