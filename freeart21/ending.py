"""How a process of ours ends: a fault in one line on standard error, and always before native libraries are taken down.

The simulator's threads may still draw when a command is over, well or not; taking it down under them crashed after the
last word was said.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import signal
import sys
import traceback
from collections.abc import Callable, Iterator
from typing import NoReturn

from freeart21 import stopping
from freeart21.errors import FreeArtError

TRACEBACK = "FREEART21_TRACEBACK"
"""Environment variable: when it is set, faults of our own come with their traceback."""

FAULT = 70
"""Exit code of a fault of our own: EX_SOFTWARE of sysexits.h."""
_READER_GONE = 128 + signal.SIGPIPE


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
            leave_stopped()  # still inside `except`: the frames keep what threads of the simulator may still use
        _said(error)


def run(main: Callable[[], None]) -> NoReturn:
    """Call `main`, and end this process as Python would after it, but by `leave`."""
    try:
        main()
    except SystemExit as end:
        leave(end.code)  # inside `except`, as above
    except BaseException:
        if stopping.told():
            leave_stopped()
        traceback.print_exc()
        leave(1)
    leave()


def leave(code: int | str | None = 0) -> NoReturn:
    """End this process with `code`, which is what `sys.exit` takes; its exit functions run, its libraries stay."""
    for number in stopping.SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    status = code if isinstance(code, int) else int(code is not None)
    atexit._run_exitfuncs()
    try:
        if sys.stdout is not None:  # as of `>&-`
            sys.stdout.flush()
    except BrokenPipeError:  # who read our output has gone, as `head` does
        status = status or _READER_GONE
    except (OSError, ValueError) as error:
        status = status or 1
        code = code or f"freeart21: standard output: {reason(error) if isinstance(error, OSError) else error}"
    with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
        if isinstance(code, str):
            print(code, file=sys.stderr)
        sys.stderr.flush()
    os._exit(status)


def leave_stopped() -> NoReturn:
    """End this process as one that was told to stop: one line, and exit code 128 + the signal's number."""
    said = stopping.kept()
    with contextlib.suppress(OSError, ValueError):
        print(f"freeart21: stopped{f'; {said}' if said else ''}", file=sys.stderr)
    leave(128 + (stopping.told() or signal.SIGINT))


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
        sys.exit(_READER_GONE)
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
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
