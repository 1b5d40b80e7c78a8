"""The effects' formulas, compiled, with a choice among them by number that costs no more than the formula."""

from __future__ import annotations

import hashlib
import inspect
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar, cast

from numba import njit

from freeart21 import events, mechanics
from freeart21.effects import EFFECTS, Effect
from freeart21.se3 import Array

FORCE, DRIVE, STOP = 0, 1, 2
ACTS = {"force": FORCE, "drive": DRIVE, "stop": STOP}

LAWS: dict[str, int] = {name: i for i, name in enumerate(n for n in EFFECTS if EFFECTS[n].acts in ACTS)}
"""Number of each law in the kernel."""
NAMES = tuple(LAWS)
"""Effect of each number."""


_Function = TypeVar("_Function", bound=Callable[..., Any])
_OPTIONS: dict[str, Any] = {"error_model": "numpy", "fastmath": {"contract"}, "_nrt": False}  # no arrays are made


def jit(function: _Function) -> _Function:
    """The compiled function."""
    return cast(_Function, njit(**_OPTIONS)(function))


def inlined(function: _Function) -> _Function:
    """The function, compiled into its callers."""
    return cast(_Function, njit(**_OPTIONS, forceinline=True)(function))


_READ_PARAMETERS = {  # slicing costs more than the formula
    1: jit(lambda p, at: (p[at],)),
    2: jit(lambda p, at: (p[at], p[at + 1])),
    3: jit(lambda p, at: (p[at], p[at + 1], p[at + 2])),
    4: jit(lambda p, at: (p[at], p[at + 1], p[at + 2], p[at + 3])),
    5: jit(lambda p, at: (p[at], p[at + 1], p[at + 2], p[at + 3], p[at + 4])),
    6: jit(lambda p, at: (p[at], p[at + 1], p[at + 2], p[at + 3], p[at + 4], p[at + 5])),
    10: jit(
        lambda p, a: (p[a], p[a + 1], p[a + 2], p[a + 3], p[a + 4], p[a + 5], p[a + 6], p[a + 7], p[a + 8], p[a + 9])
    ),
}


def _law_among(names: list[str]) -> Any:
    """A compiled choice among the laws of the effects `names`."""
    number, formula, taken = _law_parts(names[0], "law")
    others = _law_among(names[1:]) if len(names) > 1 else jit(lambda which, q, qd, load, memory, p, at: 0.0)

    @inlined
    def choose(
        which: int, q: float, qd: float, load: float, memory: float, p: Array, at: int
    ) -> float:  # pragma: no cover
        if which == number:
            return 1.0 * formula(q, qd, load, memory, *taken(p, at))
        return others(which, q, qd, load, memory, p, at)

    return choose


def _memory_among(names: list[str]) -> Any:
    """A compiled choice among the memories of the effects `names`; 0 for all others."""
    if not names:
        return jit(lambda which, q, memory, p, at: 0.0)
    number, formula, taken = _law_parts(names[0], "remember")
    others = _memory_among(names[1:])

    @inlined
    def choose(which: int, q: float, memory: float, p: Array, at: int) -> float:  # pragma: no cover
        if which == number:
            return 1.0 * formula(q, memory, *taken(p, at))
        return others(which, q, memory, p, at)

    return choose


def _law_parts(name: str, formula: str) -> tuple[int, Any, Any]:
    return LAWS[name], jit(getattr(EFFECTS[name], formula)), _READ_PARAMETERS[len(EFFECTS[name].parameters())]


law = _law_among(list(LAWS))
remember = _memory_among([n for n in LAWS if EFFECTS[n].remember is not Effect.remember])
commanded_force, delivered_force = jit(mechanics.commanded_force), jit(mechanics.delivered_force)
drive_rebound, meet_part = jit(events.drive_rebound), jit(events.meet_part)
part_at_limit, touching_side = jit(events.part_at_limit), jit(events.touching_side)
_files = (__file__, events.__file__, mechanics.__file__, *(inspect.getfile(EFFECTS[n]) for n in LAWS))
STAMP = int.from_bytes(hashlib.sha256(b"".join(Path(file).read_bytes() for file in _files)).digest()[:7], "big")
"""Hash of all formulas."""
