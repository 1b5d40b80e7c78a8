"""No words of our own: names, docstrings, comments and messages use the field's terms (CONTRIBUTING.md)."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = (
    "freeart21",
    "generator",
    "reconstruct",
    "export",
    "leaderboard",
    "simgap",
    "examples",
    "benchmarks",
    "tests",
)
FROZEN = ("leaderboard/protocols/itaco1.py", "tests/test_vocabulary.py")
"""The text of a protocol never changes, and here are the words themselves."""
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
NO_NAMES = {"said", "asked"}
"""Nor has anything else these; with NOWHERE they are what no variable, argument, field or attribute contains or is."""
WORDS = re.compile(rf"\b({'|'.join([*NOWHERE, *PHRASES])})\b", re.IGNORECASE)
ANYWHERE = re.compile(rf"(?<![a-z])({'|'.join([*NOWHERE, *NO_NAMES])})(?![a-z])", re.IGNORECASE)


def _files() -> list[Path]:
    files = {path for package in PACKAGES for path in (ROOT / package).rglob("*.py")}
    return sorted(files - {ROOT / name for name in FROZEN})


def _texts(source: str) -> list[tuple[int, str]]:
    """(line, text) of comments, and of strings with a space in them: one word alone may be a key of a file."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [
        (t.start[0], t.string)
        for t in tokens
        if t.type in (tokenize.COMMENT, tokenize.STRING) and (t.type == tokenize.COMMENT or " " in t.string)
    ]


def _names(source: str) -> list[tuple[int, str]]:
    """(line, name) of every identifier."""
    tokens = tokenize.generate_tokens(io.StringIO(source).readline)
    return [(t.start[0], t.string) for t in tokens if t.type == tokenize.NAME]


def _is_ours(name: str) -> bool:
    return name in NO_NAMES or not set(NOWHERE).isdisjoint(name.lower().strip("_").split("_"))


def faults(path: Path) -> list[str]:
    """What a file says in words of our own, a line each."""
    source, found = path.read_text(), []
    for name in re.findall(r"^\s*(?:async def|def|class) (\w+)", source, re.MULTILINE):
        parts = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name).lower().strip("_").split("_")
        if set(parts) & set(NOWHERE) or (len(parts) == 1 and parts[0] in BARE):
            found.append(f"{path.relative_to(ROOT)}: name {name}")
    if ANYWHERE.search(source):
        found += [f"{path.relative_to(ROOT)}:{line}: name {name}" for line, name in _names(source) if _is_ours(name)]
    if WORDS.search(source.replace("\n", " ")):
        for line, text in _texts(source):
            found += [f"{path.relative_to(ROOT)}:{line}: '{word}'" for word in WORDS.findall(text.replace("\n", " "))]
    return found


def test_words_of_our_own_do_not_come_back() -> None:
    found = [fault for path in _files() for fault in faults(path)]
    assert not found, "\n".join(found)
