"""Stop signals: Ctrl-C, a terminal that closes, or `kill`.

The first signal raises KeyboardInterrupt in the main thread. The contexts then clean up unfinished work, and the
process ends (`ending.exit_process`) before native libraries are torn down. Further signals during clean-up are ignored.
Nothing is written any more (`raise_if_stopped`), even when the exception was swallowed on its way.
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
"""Clean-up time before another Ctrl-C counts: workers need seconds to finish a picture."""
_AGAIN_S = 0.05
"""Delay before an interrupt is raised again that Python dropped (raised in a `__del__`, for example)."""

_signal: int = 0
_signal_at: float = 0.0
_listening = _dropped = _missed = False
_deferred: int = 0
_hints: list[Callable[[], str]] = []
_hook: Callable[[Any], Any] = sys.unraisablehook


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
