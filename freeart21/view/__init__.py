"""Pages to look at: one self-contained HTML file of a sequence, result, truth, asset, file of Gaussians or data folder.

A page is a list of sections (`document`): tables, plots, the video player, the 3D view. A section is HTML, made by a
template, with data for a script in `static/`. Images, meshes, style and scripts are inside the page; its content
security policy forbids the browser to load anything else. The pages of `site` and `gap` are made of the same sections.
"""

from freeart21.view.document import Section, document
from freeart21.view.pages import page, write_page

__all__ = ["Section", "document", "page", "write_page"]
