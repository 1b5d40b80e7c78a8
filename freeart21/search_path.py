"""Where Python looks for modules: not in the folder that the user stands in.

This module imports only what Python itself has imported before it looks into that folder.
"""

import os
import sys

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def search_path() -> list[str]:
    """`sys.path` with this package's own place and without the working folder.

    That is searched where PYTHONPATH names it in full, where the package lies in it, and where it is a `site-packages`.
    """
    try:
        here = os.getcwd()
    except OSError:  # it is gone
        here = ""
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    wanted = here in (_ROOT, *named) or os.path.basename(here) == "site-packages"
    places = [place for place in sys.path if place and (wanted or os.path.abspath(place) != here)]
    return places if _ROOT in places else [*places, _ROOT]
