"""How a command ends when it does not end well: in one line on standard error, and with an exit code."""

from __future__ import annotations

import contextlib
import os
import shutil
import sys
from collections.abc import Iterator

from freeart21 import stopping
from freeart21.errors import FreeArtError

TRACEBACK = "FREEART21_TRACEBACK"
"""Environment variable: when it is set, faults of our own come with their traceback."""

FAULT = 70
"""Exit code of a fault of our own: EX_SOFTWARE of sysexits.h."""


@contextlib.contextmanager
def in_one_line() -> Iterator[None]:
    """Ends the process, with SystemExit, when the block fails: 1 for what a user can mend, 70 for a fault of our own.

    When it was told to stop (`stopping`), whatever the block raises then is that: native code in between may have made
    another exception of it. That process ends at once, with 128 + the signal's number.
    """
    try:
        yield
        stopping.check()
    except SystemExit:
        raise
    except BaseException as error:
        if stopping.told() or isinstance(error, KeyboardInterrupt):
            stopping.leave()  # still inside `except`: the frames keep what threads of the simulator may still use
        _said(error)


def reason(error: OSError) -> str:
    """What the system says of `error`, without the paths of many files."""
    if isinstance(error, shutil.Error) and error.args and isinstance(error.args[0], list):
        listed = [entry for entry in error.args[0] if isinstance(entry, tuple) and len(entry) == 3]
        if listed:
            _, target, why = listed[0]
            words = str(why).rsplit("] ", 1)[-1].split(": '")[0]
            return f"{words} ({target}{f' and {len(listed) - 1} more files' if len(listed) > 1 else ''})"
    return error.strerror or str(error)


def _said(error: BaseException) -> None:
    if isinstance(error, FreeArtError):
        sys.exit(f"freeart21: {error}")
    if isinstance(error, BrokenPipeError):  # who read our output has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(141)
    if os.environ.get(TRACEBACK):
        raise error
    if isinstance(error, MemoryError):
        sys.exit(f"freeart21: out of memory: {_line(error) or 'no more can be had'}")
    if isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        sys.exit(f"freeart21: {place}{reason(error)}")
    print(
        f"freeart21: internal error: {type(error).__name__}: {_line(error)} (a fault of ours; {TRACEBACK}=1 shows its "
        "traceback)",
        file=sys.stderr,
    )
    sys.exit(FAULT)


def _line(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return text if len(text) <= 300 else text[:300] + " ..."
