"""How a process of FreeArt-21 ends: errors in one line on standard error, and an exit before native libraries go.

The simulator's threads may still draw when a command is over. Tearing its libraries down under them crashed.
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
"""Environment variable: when it is set, internal errors are printed with their traceback."""

DOUBTFUL = 3
"""Exit code of a result with a warning: `reconstruct` does not trust it, `export` made an asset from such a result or
with collision shapes far from the visible ones, a rule of `check-asset` failed."""

FAULT = 70
"""Exit code of an internal error: EX_SOFTWARE of sysexits.h."""
_READER_GONE = 128 + signal.SIGPIPE


@contextlib.contextmanager
def report_errors() -> Iterator[None]:
    """End the process, by SystemExit, when the block raises: code 1 for a user's error, 70 for an internal one.

    After a stop signal (`stopping`) any exception of the block counts as the stop, since native code may have replaced
    KeyboardInterrupt. That process ends at once, with code 128 + the signal's number.
    """
    try:
        yield
        stopping.raise_if_stopped()
    except SystemExit:
        raise
    except BaseException as error:
        if stopping.stop_signal() or isinstance(error, KeyboardInterrupt):
            exit_stopped()  # inside `except`: the frames keep alive what the simulator's threads may still use
        _exit_with_error(error)


def run_and_exit(main: Callable[[], None]) -> NoReturn:
    """Call `main`, and end this process as Python would, but by `exit_process`."""
    try:
        main()
    except SystemExit as end:
        exit_process(end.code)  # inside `except`, as above
    except BaseException:
        if stopping.stop_signal():
            exit_stopped()
        traceback.print_exc()
        exit_process(1)
    exit_process()


def exit_process(code: int | str | None = 0) -> NoReturn:
    """End this process with `code`, as `sys.exit` takes it. Exit functions run; native libraries are not torn down."""
    for number in stopping.SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    status = code if isinstance(code, int) else int(code is not None)
    atexit._run_exitfuncs()
    try:
        if sys.stdout is not None:  # None after `>&-`
            sys.stdout.flush()
    except BrokenPipeError:  # the reader of our output has gone, as `head` does
        status = status or _READER_GONE
    except (OSError, ValueError) as error:
        status = status or 1
        code = code or f"freeart21: standard output: {os_error_text(error) if isinstance(error, OSError) else error}"
    with contextlib.suppress(OSError, ValueError):  # the terminal may be gone
        if isinstance(code, str):
            print(code, file=sys.stderr)
        sys.stderr.flush()
    os._exit(status)


def exit_stopped() -> NoReturn:
    """End this process after a stop signal: one line, and exit code 128 + the signal's number."""
    hint = stopping.current_hint()
    with contextlib.suppress(OSError, ValueError):
        print(f"freeart21: stopped{f'; {hint}' if hint else ''}", file=sys.stderr)
    exit_process(128 + (stopping.stop_signal() or signal.SIGINT))


def os_error_text(error: OSError) -> str:
    """The system's words for `error`; of a failed copy of many files, those for the first file and a count."""
    if isinstance(error, shutil.Error) and error.args and isinstance(error.args[0], list):
        failed = [entry for entry in error.args[0] if isinstance(entry, tuple) and len(entry) == 3]
        if failed:
            _, target, why = failed[0]
            words = str(why).rsplit("] ", 1)[-1].split(": '")[0]
            return f"{words} ({target}{f' and {len(failed) - 1} more files' if len(failed) > 1 else ''})"
    return error.strerror or str(error)


def _exit_with_error(error: BaseException) -> None:
    if isinstance(error, FreeArtError):
        sys.exit(f"freeart21: {error}")
    if isinstance(error, BrokenPipeError):  # the reader of our output has gone
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(_READER_GONE)
    if os.environ.get(TRACEBACK):
        traceback.print_exception(error)
    text = " ".join(str(error).split())
    text = text if len(text) <= 300 else text[:300] + " ..."
    if isinstance(error, MemoryError):
        sys.exit(f"freeart21: out of memory: {text or 'no more can be had'}")
    if isinstance(error, OSError):
        place = "" if error.filename is None else f"{error.filename}: "
        sys.exit(f"freeart21: {place}{os_error_text(error)}")
    print(
        f"freeart21: internal error: {type(error).__name__}: {text} (a fault of ours; {TRACEBACK}=1 shows its "
        "traceback)",
        file=sys.stderr,
    )
    sys.exit(FAULT)
