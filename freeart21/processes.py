"""Processes of FreeArt-21: how they are started, stopped and end.

Started: child processes do work that may crash, hang or fill the memory. They do not search the user's working folder
for modules: results come from anywhere, and a `numpy.py` among them must not be imported.

Stopped: by Ctrl-C, a terminal that closes, or `kill`. The first signal raises KeyboardInterrupt in the main thread. The
contexts then clean up unfinished work, and the process ends (`exit_process`) before native libraries are torn down.
Further signals during clean-up are ignored. Nothing is written any more (`raise_if_stopped`), even when the exception
was swallowed on its way.

Ended: errors in one line on standard error, and an exit before native libraries go. The simulator's threads may still
draw when a command is over. Tearing its libraries down under them crashed.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import shutil
import signal
import sys
import time
import traceback
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any, NoReturn

from freeart21.errors import FreeArtError
from freeart21.search_path import search_path

TRACEBACK = "FREEART21_TRACEBACK"
"""Environment variable: when it is set, internal errors are printed with their traceback."""

DOUBTFUL = 3
"""Exit code of a result with a warning: `reconstruct` does not trust it, `export` made an asset from such a result or
with collision shapes far from the visible ones, a rule of `check-asset` failed."""

FAULT = 70
"""Exit code of an internal error: EX_SOFTWARE of sysexits.h."""
_READER_GONE = 128 + signal.SIGPIPE

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Each means stop."""

_PATIENCE_S = 10.0
"""Clean-up time before another Ctrl-C counts: workers need seconds to finish a picture."""
_AGAIN_S = 0.05
"""Delay before an interrupt is raised again that Python dropped (raised in a `__del__`, for example)."""

_signal: int = 0
_signal_at: float = 0.0
_listening = _dropped = _missed = False
_deferred: int = 0
_hints: list[Callable[[], str]] = []
_hook: Callable[[Any], Any] = sys.unraisablehook


# --- started ----------------------------------------------------------------------------------------------------------


def python(code: str) -> list[str]:
    """The command line that runs `code` in another Python with this one's module search path.

    It is isolated (-I): it searches neither the working folder nor the places that PYTHON variables name.
    """
    return [sys.executable, "-I", "-c", f"import sys; sys.path[:] = {search_path()!r}\n{code}"]


def command(module: str) -> list[str]:
    """The command line that runs `main()` of `module` as `python` does, and ends by `run_and_exit`."""
    return python(f"from freeart21.processes import run_and_exit\nfrom {module} import main\nrun_and_exit(main)")


def one_line(error: BaseException) -> str:
    """The first line of an error's message, or its type when the message is empty."""
    return (str(error).strip().splitlines() or [type(error).__name__])[0]


# --- stopped ----------------------------------------------------------------------------------------------------------


def listen() -> None:
    """Handle stop signals from now to the end of the process. Signals that are ignored stay ignored."""
    global _listening, _hook
    if _listening:
        return
    _listening = True
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # `nohup` and a shell's '&' ignore some
            signal.signal(number, _on_signal)
    _hook, sys.unraisablehook = sys.unraisablehook, _on_unraisable


def stop_signal() -> int:
    """The number of the stop signal that arrived; 0 when none did."""
    return _signal


def raise_if_stopped() -> None:
    """Raise KeyboardInterrupt when a stop signal has arrived."""
    if _signal:
        raise KeyboardInterrupt


@contextlib.contextmanager
def defer_stop() -> Iterator[None]:
    """Run the block to its end: a stop signal takes effect after it."""
    global _deferred, _missed
    _deferred += 1
    try:
        yield
    finally:
        _deferred -= 1
    if _missed and not _deferred:
        _missed = False
        raise KeyboardInterrupt


@contextlib.contextmanager
def resume_hint(hint: Callable[[], str]) -> Iterator[None]:
    """If the block is stopped, the last line printed is `hint()`: what was saved, and how to go on."""
    _hints.append(hint)
    yield
    _hints.remove(hint)


def current_hint() -> str:
    """The text of the innermost interrupted `resume_hint` block that has one; '' when none has."""
    return next((text for hint in reversed(_hints) if (text := hint())), "")


@contextlib.contextmanager
def block_signals() -> Iterator[None]:
    """Child processes that start in this block ignore the terminal's stop signals: their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _on_signal(number: int, frame: FrameType | None) -> None:
    global _signal, _signal_at, _dropped, _missed
    now = time.monotonic()
    if _signal and not _dropped and now - _signal_at < _PATIENCE_S:
        return
    if number != signal.SIGALRM:
        _signal = number
    _signal_at, _dropped = now, False
    if _deferred:
        _missed = True
        return
    raise KeyboardInterrupt


def _on_unraisable(unraisable: Any) -> None:
    """Python's hook for exceptions that it cannot raise. An interrupt among them is raised again a moment later."""
    global _dropped
    if not _signal:
        _hook(unraisable)
    elif isinstance(unraisable.exc_value, KeyboardInterrupt):
        _dropped = True
        signal.signal(signal.SIGALRM, _on_signal)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)


# --- ended ------------------------------------------------------------------------------------------------------------


@contextlib.contextmanager
def report_errors() -> Iterator[None]:
    """End the process, by SystemExit, when the block raises: code 1 for a user's error, 70 for an internal one.

    After a stop signal any exception of the block counts as the stop, since native code may have replaced
    KeyboardInterrupt. That process ends at once, with code 128 + the signal's number.
    """
    try:
        yield
        raise_if_stopped()
    except SystemExit:
        raise
    except BaseException as error:
        if stop_signal() or isinstance(error, KeyboardInterrupt):
            exit_stopped()  # inside `except`: the frames keep alive what the simulator's threads may still use
        _exit_with_error(error)


def run_and_exit(main: Callable[[], None]) -> NoReturn:
    """Call `main`, and end this process as Python would, but by `exit_process`."""
    try:
        main()
    except SystemExit as end:
        exit_process(end.code)  # inside `except`, as above
    except BaseException:
        if stop_signal():
            exit_stopped()
        traceback.print_exc()
        exit_process(1)
    exit_process()


def exit_process(code: int | str | None = 0) -> NoReturn:
    """End this process with `code`, as `sys.exit` takes it. Exit functions run; native libraries are not torn down."""
    for number in SIGNALS:
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
    hint = current_hint()
    with contextlib.suppress(OSError, ValueError):
        print(f"freeart21: stopped{f'; {hint}' if hint else ''}", file=sys.stderr)
    exit_process(128 + (stop_signal() or signal.SIGINT))


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
