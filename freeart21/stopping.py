"""Being told to stop: by Ctrl-C, by a terminal that closes, or by `kill`.

A command is told once, by KeyboardInterrupt in its main thread; then its contexts clear up what is half done, and the
process ends (`ending.leave`) before the native libraries are taken down. Telling again while things are cleared up does
nothing; nothing is written any more (`check`), whatever became of the exception on its way.
"""

from __future__ import annotations

import contextlib
import signal
import sys
import time
from collections.abc import Callable, Iterator
from types import FrameType
from typing import Any

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Each means stop."""

_PATIENCE_S = 10.0
"""How long clearing up may take before another Ctrl-C is heeded: workers in the midst of a picture need seconds."""
_AGAIN_S = 0.05
"""After so long an interrupt is raised anew that was raised where Python drops it (in a `__del__`, say)."""

_told: int = 0
_told_at: float = 0.0
_listening = _dropped = _missed = False
_deferred: int = 0
_hints: list[Callable[[], str]] = []
_hook: Callable[[Any], Any] = sys.unraisablehook


def listen() -> None:
    """Take stop signals as this module says, from now to the process's end; those that are ignored stay ignored."""
    global _listening, _hook
    if _listening:
        return
    _listening = True
    for number in SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:  # as of `nohup`, or of a shell's '&'
            signal.signal(number, _heed)
    _hook, sys.unraisablehook = sys.unraisablehook, _dropped_somewhere


def told() -> int:
    """The number of the signal that said stop; 0 when none did."""
    return _told


def check() -> None:
    """Raise KeyboardInterrupt when the process was told to stop."""
    if _told:
        raise KeyboardInterrupt


@contextlib.contextmanager
def deferred() -> Iterator[None]:
    """What happens in this block happens whole: being told to stop takes effect at its end."""
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
def explained(hint: Callable[[], str]) -> Iterator[None]:
    """While the block runs, `hint` says (when stopped, after clearing up) what is kept and how to go on."""
    _hints.append(hint)
    yield
    _hints.remove(hint)


def kept() -> str:
    """What the innermost of the blocks `explained` says that was left by an interrupt; '' when none says anything."""
    return next((said for hint in reversed(_hints) if (said := hint())), "")


@contextlib.contextmanager
def unheard() -> Iterator[None]:
    """Processes that are started in this block do not hear what a terminal tells them all: their parent ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, SIGNALS)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _heed(number: int, frame: FrameType | None) -> None:
    global _told, _told_at, _dropped, _missed
    now = time.monotonic()
    if _told and not _dropped and now - _told_at < _PATIENCE_S:
        return
    if number != signal.SIGALRM:
        _told = number
    _told_at, _dropped = now, False
    if _deferred:
        _missed = True
        return
    raise KeyboardInterrupt


def _dropped_somewhere(unraisable: Any) -> None:
    """Python's hook for exceptions that it cannot raise: an interrupt among them is raised again, a moment later."""
    global _dropped
    if not _told:
        _hook(unraisable)
    elif isinstance(unraisable.exc_value, KeyboardInterrupt):
        _dropped = True
        signal.signal(signal.SIGALRM, _heed)
        signal.setitimer(signal.ITIMER_REAL, _AGAIN_S)
