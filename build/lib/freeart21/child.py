"""A Python of one's own for work that may crash, hang or fill the memory."""

from __future__ import annotations

import json
import sys


def command(module: str) -> list[str]:
    """The command line that runs `main()` of `module` in another Python, which finds modules where this one does.

    The folder that one stands in is not searched: results come from anywhere, and a `numpy.py` among them must not be
    what is imported.
    """
    places = [place for place in sys.path if place]
    return [sys.executable, "-c", f"import sys; sys.path[:] = {places!r}; from {module} import main; main()"]


def one_line(error: BaseException) -> str:
    """An error as one line: its first, or its type when it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def answer(**what: object) -> None:
    """Say `what` as the last line of standard output, whatever native code has printed before."""
    print("\n" + json.dumps(what), flush=True)
