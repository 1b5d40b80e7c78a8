"""Python's module search path without the user's working folder.

This module imports only what Python itself imports before it looks into that folder.
"""

import os
import sys

_ROOT = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
_MODULES = {
    "generator": "recorder",
    "reconstruct": "pipeline",
    "export": "exporter",
    "leaderboard": "score",
    "simgap": "workflow",
}
"""Our other top-level packages, each with a module that identifies it: other projects use such names, too."""


def search_path() -> list[str]:
    """`sys.path` with the folder of this package and without the working folder.

    The working folder stays where PYTHONPATH names it in full, where this package lies in it, or where it is a
    `site-packages`. The folder of this package comes before any other with a package of the same name as one of ours.
    """
    try:
        here = os.getcwd()
    except OSError:  # it was removed
        here = ""
    named = os.environ.get("PYTHONPATH", "").split(os.pathsep)
    wanted = here in (_ROOT, *named) or os.path.basename(here) == "site-packages"
    places = [place for place in sys.path if place and (wanted or os.path.abspath(place) != here)]
    ours = places.index(_ROOT) if _ROOT in places else len(places)
    clash = next((i for i, place in enumerate(places[:ours]) if _has_clash(place)), ours)
    others = [place for place in places if place != _ROOT]
    return [*others[:clash], _ROOT, *others[clash:]]


def replaced_package() -> str | None:
    """One line about a top-level package of ours that another project has replaced; None when there is none."""
    for package, module in _MODULES.items():
        if not os.path.isfile(os.path.join(_ROOT, package, f"{module}.py")):
            folder = os.path.join(_ROOT, package)
            return (
                f"package {package}: {folder} is not FreeArt-21's (no {module}.py): another project of that name was "
                "installed over it; install freeart21 in an environment of its own"
            )
    return None


def _has_clash(place: str) -> bool:
    return any(
        os.path.isdir(os.path.join(place, name)) or os.path.isfile(os.path.join(place, f"{name}.py"))
        for name in _MODULES
    )
