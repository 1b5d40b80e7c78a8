"""An effect is one file: no other product code refers to one by name or class."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

from freeart21.effects import ASSET_ERRORS
from freeart21.effects import EFFECTS as LIBRARY

EFFECTS = LIBRARY | ASSET_ERRORS
ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("freeart21", "simgap", "export", "generator", "leaderboard", "reconstruct")
NAMES = re.compile(rf"(?<![\w.])({'|'.join(EFFECTS)})(?!\w)")
CLASSES = {cls.__name__ for cls in EFFECTS.values()}
WORDS = {
    "export/check/engines/drake_world.py": {"CoulombFriction"},
    "export/mjcf.py": {"armature"},
    "export/usd.py": {"armature"},
    "export/loaders": {"armature"},
    "simgap/prove/writeback.py": {"armature"},
    "generator/objects": {"latch"},
}
"""Terms of file formats, engines and object parts that are also effect names."""


def mentions(source: str, allowed: frozenset[str] = frozenset()) -> list[tuple[int, str]]:
    """(line, name) of every effect that a module refers to: in a string (not a docstring), by class, by module."""
    found, tree = [], ast.parse(source)
    prose = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and id(node) not in prose:
            names = [node.value] if node.value in EFFECTS else [n for n in NAMES.findall(node.value) if "_" in n]
        elif isinstance(node, ast.Name):
            names = [node.id] if node.id in CLASSES else []
        elif isinstance(node, ast.Attribute):
            names = [node.attr] if node.attr in CLASSES else []
        elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("freeart21.effects"):
            own = [(node.module or "").split(".")[-1], *(alias.name for alias in node.names)]
            names = [n for n in own if n in EFFECTS or n in CLASSES]
        found += [(node.lineno, name) for name in names if name not in allowed]
    return found


def named_in(path: Path) -> list[str]:
    """file:line: name of every mention in a product file."""
    name = path.relative_to(ROOT).as_posix()
    allowed = frozenset(word for place, words in WORDS.items() if name.startswith(place) for word in words)
    return [f"{name}:{line}: {what}" for line, what in mentions(path.read_text(), allowed)]


def test_effects_are_not_named_outside_their_file():
    paths = [p for package in PACKAGES for p in (ROOT / package).rglob("*.py")]
    own = ROOT / "freeart21" / "effects"
    found = {p.relative_to(ROOT).as_posix(): named_in(p) for p in sorted(paths) if own not in p.parents}
    wrong = [line for lines in found.values() for line in lines]
    assert not wrong, "\n".join(wrong)


@pytest.mark.parametrize(
    "planted",
    [
        "from freeart21.effects.backlash import Backlash",
        "from freeart21.effects import armature",
        "from freeart21.effects import ViscousDamping as V",
        "def f(e):\n    return isinstance(e, effects.Sag)",
        "LOSSES = ('viscous_damping',)",
        "def f(e):\n    '''Text.'''\n    return e.name == 'wobble'",
        "raise ValueError('the joint has coulomb_friction already')",
    ],
)
def test_a_planted_mention_is_found(planted: str):
    assert mentions(planted)


def test_prose_and_other_words_are_no_mention():
    source = '"""A wobble, as `viscous_damping` has it."""\narmature = 1.0  # backlash\nwords = "a sag of 3 mm"\n'
    assert not mentions(source)
