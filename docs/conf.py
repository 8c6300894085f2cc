"""Settings of Sphinx for the pages that `docs/build_site.py` has put together."""

from aces_bus import __version__

project = "aces-bus"
author = "the aces-bus contributors"
copyright = author
release = version = __version__
extensions = ["myst_parser"]
source_suffix = {".md": "markdown"}
root_doc = "index"
myst_enable_extensions = ["colon_fence"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = f"aces-bus {__version__}"
html_copy_source = html_show_sourcelink = html_show_sphinx = False
html_theme_options = {"navigation_with_keys": True, "top_of_page_buttons": []}
html_static_path = ["_static"]
html_css_files = ["site.css"]
nitpicky = True
# A page of code is highlighted where it can be: console sessions and doctests with made-up parts cannot.
suppress_warnings = ["misc.highlighting_failure"]
