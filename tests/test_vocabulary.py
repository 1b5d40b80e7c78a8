"""No words of our own: names, docstrings, comments and messages use the field's terms (CONTRIBUTING.md)."""

from __future__ import annotations

import ast
import io
import re
import tokenize
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
CLEAN: tuple[str, ...] = (
    "generator",
    "leaderboard/*.py",
    "leaderboard/adapters",
    "leaderboard/protocols",
    "leaderboard/suite",
    "reconstruct",
    "simgap",
    "freeart21/effects",
    "freeart21/gaussians.py",
    "freeart21/reconstruction.py",
    "freeart21/trust.py",
    "freeart21/z_buffer.py",
    "freeart21/base_motion.py",
    "freeart21/camera_faults.py",
    "freeart21/events.py",
    "freeart21/measured.py",
    "freeart21/mechanics.py",
    "export",
    "freeart21/asset.py",
    "freeart21/files",
    "freeart21/formats",
    "freeart21/jobs",
    "freeart21/__init__.py",
    "freeart21/__main__.py",
    "freeart21/articulation.py",
    "freeart21/camera.py",
    "freeart21/catalog.py",
    "freeart21/child.py",
    "freeart21/cli.py",
    "freeart21/code.py",
    "freeart21/doctor.py",
    "freeart21/ending.py",
    "freeart21/errors.py",
    "freeart21/help.py",
    "freeart21/joint.py",
    "freeart21/mesh.py",
    "freeart21/one_euro.py",
    "freeart21/recording.py",
    "freeart21/registry.py",
    "freeart21/se3.py",
    "freeart21/search_path.py",
    "freeart21/sphere.py",
    "freeart21/statistics.py",
    "freeart21/stopping.py",
    "freeart21/submovements.py",
    "freeart21/truth.py",
    "freeart21/turns.py",
    "freeart21/view",
    "leaderboard/site",
)
"""Packages and modules that are held to it: all but those that nobody has rewritten yet."""
FROZEN = ("leaderboard/protocols/itaco1.py",)
"""The text of a protocol never changes."""
NOWHERE = [
    "foretold",
    "foretelling",
    "foretell",
    "withstood",
    "nameless",
    "alike",
    "plainer",
    "departs",
    "departing",
    "departures",
    "stilled",
    "tempered",
    "swayed",
    "hearsay",
    "hush",
    "wishes",
    "strokes",
    "mend",
    "mended",
    "mends",
    "borne",
    "lest",
    "twin",
    "twins",
    "thrown",
    "rumour",
    "rumours",
    "told",
    "spoken",
    "begun",
]
PHRASES = ("hangs on a hair", "comes of", "of which", "may not", "beside it", "is said", "are said", "says how")
BARE = [
    "said",
    "kept",
    "left",
    "asked",
    "caught",
    "grown",
    "found",
    "made",
    "drawn",
    "seen",
    "held",
    "apart",
    "beside",
    "idle",
    "loud",
    "usual",
    "tried",
    "shown",
]
"""No function or class has such a word alone as its name."""


def _files() -> list[Path]:
    places = [path for name in CLEAN for path in ROOT.glob(name)]
    files = {f for p in places for f in ([p] if p.is_file() else p.rglob("*.py"))}
    return sorted(files - {ROOT / name for name in FROZEN})


def _texts(source: str) -> list[tuple[int, str]]:
    """(line, text) of comments, and of strings with a space in them: one word alone may be a key of a file."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [
        (t.start[0], t.string)
        for t in tokens
        if t.type in (tokenize.COMMENT, tokenize.STRING) and (t.type == tokenize.COMMENT or " " in t.string)
    ]


def faults(path: Path) -> list[str]:
    """What a file says in words of our own, a line each."""
    source, found = path.read_text(), []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef, ast.ClassDef)):
            parts = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", node.name).lower().strip("_").split("_")
            if set(parts) & set(NOWHERE) or (len(parts) == 1 and parts[0] in BARE):
                found.append(f"{path.relative_to(ROOT)}:{node.lineno}: name {node.name}")
    words = re.compile(rf"\b({'|'.join([*NOWHERE, *PHRASES])})\b", re.IGNORECASE)
    for line, text in _texts(source):
        found += [f"{path.relative_to(ROOT)}:{line}: '{match}'" for match in words.findall(text.replace("\n", " "))]
    return found


@pytest.mark.quick
def test_words_of_our_own_do_not_come_back() -> None:
    found = [fault for path in _files() for fault in faults(path)]
    assert not found, "\n".join(found)
