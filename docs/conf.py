"""Sphinx: Markdown pages, the API written from the objects themselves, search that works without a network."""

import re
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent / "src"), str(HERE)]

import api_pages  # noqa: E402
import pictures  # noqa: E402

project = "Ultraquiet"
author = "the authors of Ultraquiet"
copyright = "the authors of Ultraquiet, BSD-3-Clause"
release = version = tomllib.loads((HERE.parent / "pyproject.toml").read_text())["project"]["version"]

extensions = ["myst_parser"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "examples"]
nitpicky = True
# Types of a signature are shown, not linked: many are protocols of one room.
nitpick_ignore_regex = [("py:.*", ".*")]
python_use_unqualified_type_names = True
highlight_language = "text"

html_theme = "furo"
html_title = "Ultraquiet"
html_extra_path = ["summary.schema.json"]
html_show_sourcelink = False
html_copy_source = False
html_theme_options = {
    "light_css_variables": {"color-brand-primary": "#0072B2", "color-brand-content": "#0072B2"},
    "dark_css_variables": {"color-brand-primary": "#56B4E9", "color-brand-content": "#56B4E9"},
}


# Pages of the repository's root that are part of the site, where readers of the repository find them beside the code.
AT_THE_ROOT = {"SECURITY.md": "/reference/security.md", "CHANGELOG.md": "/reference/changelog.md"}


def lead_to_pages(app, docname, source):
    """Let links to pages of the root lead to those of the site."""
    for name, page in AT_THE_ROOT.items():
        source[0] = re.sub(rf"\]\((?:\.\./)+{re.escape(name)}", f"]({page}", source[0])


def setup(app):
    """Write what is generated before any page is read."""
    app.connect("source-read", lead_to_pages)
    api_pages.write(HERE / "reference" / "api")
    pictures.write(HERE / "gallery" / "pictures", HERE / "gallery" / "index.md")
