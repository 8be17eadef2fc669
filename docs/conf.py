"""Settings of the site: python -m sphinx -W --keep-going docs build/site, without network."""

import os
import sys
from pathlib import Path

import jax
import matplotlib as mpl

HERE = Path(__file__).parent
sys.path.insert(0, str(HERE / "_site"))

import docstrings  # noqa: E402
import gallery  # noqa: E402
import links  # noqa: E402
import problem_pages  # noqa: E402
import reference  # noqa: E402
import search  # noqa: E402
from retrax import __version__  # noqa: E402

jax.config.update("jax_enable_x64", True)
mpl.use("Agg")

project, author, copyright = (
    "retrax",
    "The retrax authors",
    "The retrax authors",
)
version = release = __version__
extensions = [
    "myst_parser",
    "sphinx.ext.autodoc",
    "sphinx.ext.mathjax",
    # MathJax as a package of pip, copied into the site: the one from npm would need Node where the site is built.
    "sphinx-mathjax-offline",
    "sphinx_gallery.gen_gallery",
]
myst_enable_extensions = ["dollarmath", "amsmath"]
mathjax3_config = {
    "chtml": {"mtextInheritFont": True}
}  # the packaged release is 3.2.2
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_site"]
html_theme, html_title = "furo", f"retrax {__version__}"
html_static_path, html_css_files = ["_site/static"], ["landing.css"]
html_show_sourcelink = False
highlight_language = "none"  # formulas are set off as literal blocks
myst_heading_anchors = 3
autodoc_member_order, autodoc_typehints_format = "bysource", "short"
autodoc_default_options = {"members": True, "show-inheritance": True}
autodoc_preserve_defaults = True
templates_path: list[str] = []

# Which examples run when the site is built, a pattern: all of them, or one while its page is written.
RUN = os.environ.get("RETRAX_SITE_EXAMPLES", ".*")
sphinx_gallery_conf = {
    "examples_dirs": [str(HERE.parent / "examples")],
    "gallery_dirs": ["examples"],
    "filename_pattern": rf"/({RUN})\.py$",
    "parallel": os.cpu_count(),
    "capture_repr": (),  # a cell shows what it prints
    "remove_config_comments": True,
    "abort_on_example_error": True,
    "within_subsection_order": "FileNameSortKey",
    "show_signature": False,
    "download_all_examples": False,
    "min_reported_time": 1e9,
    "write_computation_times": False,
}
suppress_warnings = ["config.cache"]

reference.write(HERE / "api")
problem_pages.write(HERE / "library")


def setup(app):
    """Connect events with changes to pages and docstrings, and with the checks of the finished site."""
    app.connect("source-read", gallery.process)
    app.connect("autodoc-process-docstring", docstrings.process)
    app.connect("autodoc-process-signature", docstrings.sign)
    app.connect("build-finished", links.check)
    app.connect("build-finished", search.check)
