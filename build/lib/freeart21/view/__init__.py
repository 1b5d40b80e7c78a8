"""Pages to look at: one self-contained HTML file for a sequence, a result, a truth, an asset or a whole data folder.

A page is a list of sections, each built by one small function: `video_section` (the player), `scene_section` (parts and
joint in 3D), `plot_section` (the joint state over time) and `table_section` (numbers). A section is HTML plus data; the
scripts in `static/` bring it to life. A page loads nothing: pictures, meshes, style and scripts are inside it, and its
content security policy forbids the browser to fetch anything.
"""

from freeart21.view.document import Section, document
from freeart21.view.pages import page, write_page

__all__ = ["Section", "document", "page", "write_page"]
