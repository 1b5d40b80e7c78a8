"""Command lines of child processes, for work that may crash, hang or fill the memory.

Child processes do not search the user's working folder for modules: results come from anywhere, and a `numpy.py` among
them must not be imported.
"""

from __future__ import annotations

import sys

from freeart21.search_path import search_path


def python(code: str) -> list[str]:
    """The command line that runs `code` in another Python with this one's module search path.

    It is isolated (-I): it searches neither the working folder nor the places that PYTHON variables name.
    """
    return [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {search_path()!r}\n{code}"]


def command(module: str) -> list[str]:
    """The command line that runs `main()` of `module` as `python` does, and ends by `ending.run_and_exit`."""
    return python(f"from freeart21.ending import run_and_exit\nfrom {module} import main\nrun_and_exit(main)")


def one_line(error: BaseException) -> str:
    """The first line of an error's message, or its type when the message is empty."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
