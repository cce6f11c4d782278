"""Settings of the site: `python -m sphinx -W --keep-going docs build/site` builds guide, gallery and API reference, strictly.

A broken link, a heading that is not there, a public name that cannot be imported or a docstring that cannot be read ends the build with
exit status 1. The pages need no network: neither while they are built, nor in the browser.
"""

from __future__ import annotations

import gc
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent / "_site"))

import asterism

# A build makes hundreds of thousands of nodes and nearly no garbage: looking for it as often as Python does is a third of the time.
gc.set_threshold(100_000, 20, 1_000)

project = "Asterism"
author = "the Asterism developers"
copyright = author
version = release = asterism.__version__

extensions = ["myst_parser", "sphinx.ext.autodoc", "contents", "docstrings"]
root_doc = "index"
source_suffix = {".md": "markdown", ".rst": "restructuredtext"}
exclude_patterns = ["_site"]

smartquotes = False  # it would print R' as R followed by a quotation mark
myst_heading_anchors = 4

autodoc_member_order = "bysource"
autodoc_default_options = {"members": True}
autodoc_preserve_defaults = True
autodoc_typehints_format = "short"
autodoc_class_signature = "mixed"
python_maximum_signature_line_length = 88
python_use_unqualified_type_names = True
add_module_names = False
toc_object_entries_show_parents = "hide"

# An annotation that could mean two classes of one name.
suppress_warnings = ["ref.python"]

html_theme = "furo"
html_title = f"Asterism {version}"
html_copy_source = False
html_show_sphinx = False
html_static_path = ["_site/static"]
html_favicon = "_site/static/favicon.svg"
html_css_files = ["asterism.css"]
pygments_style = "tango"
