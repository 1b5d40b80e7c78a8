"""A Python of one's own for work that may crash, hang or fill the memory: how every process of ours is started.

Results come from anywhere, and a `numpy.py` among them must not be what is imported: no process of ours searches the
folder that the user stands in.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Iterator
from pathlib import Path

from freeart21.search_path import search_path


def python(code: str) -> list[str]:
    """The command line that runs `code` in another Python, which finds modules where this one does.

    It is isolated (-I): from its start it searches neither the working folder nor what PYTHON variables name.
    """
    return [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {search_path()!r}\n{code}"]


def command(module: str) -> list[str]:
    """The command line that runs `main()` of `module` in another Python, as `python` does, and ends by `ending.run`."""
    return python(f"from freeart21.ending import run\nfrom {module} import main\nrun(main)")


@contextlib.contextmanager
def spawn_in(folder: Path) -> Iterator[None]:
    """Processes that multiprocessing starts in this block begin in `folder`, which is empty and outlives them.

    Its command lines are its own: they import from the folder that they begin in, and then take this process's search
    path. Who needs another folder goes there when it has begun.
    """
    here, before = Path.cwd(), sys.path[:]
    sys.path[:] = search_path()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(here)
        sys.path[:] = before


def one_line(error: BaseException) -> str:
    """An error as one line: its first, or its type when it says nothing."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


def answer(**what: object) -> None:
    """Say `what` as the last line of standard output, whatever native code has printed before."""
    print("\n" + json.dumps(what), flush=True)
