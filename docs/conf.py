"""Configuration of the documentation; ``scripts/build_docs`` builds it with warnings as errors."""

from __future__ import annotations

import inspect
import re
import shutil
from enum import Enum
from importlib import import_module
from pathlib import Path
from typing import Any

import rmesh_nlp

ROOT = Path(__file__).parent.parent

project = "rmesh_nlp"
author = "the authors of rmesh_nlp"
version = release = rmesh_nlp.__version__

extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "sphinx.ext.viewcode",
    "sphinx_gallery.gen_gallery",
    "sphinxcontrib.katex",
]
katex_css_path = "katex-math.css"  # a copy, and MathML without fonts: pages need no network
katex_options = 'output: "mathml"'
katex_prerender = shutil.which("node") is not None  # else the browser does it, by a copy of the script
BELOW = {
    "index": ["getting_started", "theory", "howto", "api", "results"],
    "howto": [
        "own_problems",
        "parts",
        "two_bodies",
        "revolution",
        "formulations",
        "without_move_limits",
        "order_and_relocation",
        "objectives",
        "design_punch",
        "design_seal",
        "design_identification",
        "relocation_friction",
        "biactive",
        "accuracy",
        "certificate",
        "studies",
        "mpcc_solver",
        "own_formulation",
        "gallery/index",
    ],
    "api": ["command_line", "records", "assessment", "code"],
    "results": ["reproduction"],
}
"""The menu: the pages below a page. Pages are plain Markdown, which a repository shows as well."""

exclude_patterns = [
    "_build",
    "reference/names.rst",
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
html_static_path = ["_static"]
html_css_files = ["formulas.css"]
html_sidebars = {name: [] for name in ("index", "getting_started", "theory")}

myst_enable_extensions = ["colon_fence", "dollarmath"]
myst_heading_anchors = 3
suppress_warnings = ["myst.xref_missing"]

autosummary_generate = ["reference/names.rst"]  # written by setup
autosummary_imported_members = False
autodoc_typehints = "description"
autodoc_typehints_description_target = "documented_params"  # a type without a meaning helps nobody
autodoc_member_order = "bysource"
autodoc_type_aliases = {name: name for name in ("Array", "Index", "Mask", "Expression", "Coefficient")}
napoleon_google_docstring = False
napoleon_use_ivar = True


def add_inherited_fields(app: Any, what: str, name: str, obj: Any, options: Any, lines: list[str]) -> None:
    """Append the ``Attributes`` of base classes: a reader of a class sees the meaning of every field.

    An enumeration gets its members. A colon in the first line of a property becomes a dash.
    """
    if what == "property" and lines:
        lines[0] = lines[0].replace(": ", " – ")  # napoleon takes what is before a colon for a type
    if what != "class":
        return
    if issubclass(obj, Enum):
        lines.extend(["", *(f"- ``{one.value}``: {getattr(one, 'message', '')}" for one in obj)])
    for base in obj.__mro__[1:]:
        text = inspect.getdoc(base) if base.__module__.startswith(("rmesh_nlp", "formulations")) else ""
        _, heading, fields = (text or "").partition("Attributes\n----------\n")
        if heading and "".join(fields.split()) not in "".join("".join(lines).split()):
            lines.extend(["", *heading.splitlines(), *fields.split("\n\n")[0].splitlines(), ""])


def has_no_meaning(app: Any, what: str, name: str, obj: Any, skip: bool, options: Any) -> bool | None:
    """Whether a member gets no entry: fields stand in the text of their class, others in that of a base."""
    made = obj.fget if isinstance(obj, property) else getattr(obj, "func", obj)
    home = getattr(made, "__module__", None) or ""
    return None if home.startswith(("rmesh_nlp", "formulations")) and inspect.isroutine(made) else True


def with_summaries(text: str, folder: str) -> str:
    """Tables of public names as summaries that link to a page of each name, in a folder."""

    def summary(table: re.Match[str]) -> str:
        found = [name.replace("rm.", "rmesh_nlp.") for name in re.findall(r"^\| `([\w.]+)`", table[0], re.M)]
        names = "\n   ".join(f"~{name}" if name.count(".") == 1 else name for name in found)
        directive = f".. autosummary::\n   :toctree: {folder}\n   :nosignatures:\n\n   {names}"
        return f"```{{eval-rst}}\n{directive}\n```\n"

    return re.sub(r"\| name \| .*\n\|---\|---\|\n(\| `.*\n)+", summary, text)


def for_sphinx(app: Any, name: str, source: list[str]) -> None:
    """Add what only the site has: pages of public names, and the menu."""
    if name == "api":
        source[0] = with_summaries(source[0], "reference")
    if name in BELOW:
        source[0] += "\n```{toctree}\n:hidden:\n:maxdepth: 1\n\n" + "\n".join(BELOW[name]) + "\n```\n"


def setup(app: Any) -> None:
    """Register the hooks above, and write the names that get pages."""
    import_module("sphinxcontrib.katex").KATEX_DEFAULT_OPTIONS["output"] = "mathml"  # of what node renders
    app.connect("autodoc-process-docstring", add_inherited_fields, priority=400)
    app.connect("autodoc-skip-member", has_no_meaning)
    app.connect("source-read", for_sphinx)
    names = ROOT / "docs" / "reference" / "names.rst"
    names.parent.mkdir(exist_ok=True)
    names.write_text(with_summaries((ROOT / "docs" / "api.md").read_text(), ""))


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
