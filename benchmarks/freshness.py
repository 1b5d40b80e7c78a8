"""Whether the figures that README and docs print are older than the code that they speak of.

A section that prints figures ends with a line such as

    *Measured at `84f6ef9`, of `reconstruct`, `leaderboard` ([file](../benchmarks/results/reconstruct.json)): old.*

It names the commit (that of the file, if one is named), the packages or files that the figures speak of, and says `old`
when what these do has changed since (comments, docstrings and layout do not count), `current` when it has not. A commit
that this history does not hold, or that had uncommitted changes, is old.

    python -m benchmarks.freshness            # prints a table
    python -m benchmarks.freshness --write    # corrects the lines in the documents
"""

from __future__ import annotations

import argparse
import json
import re
import subprocess
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from benchmarks.common import ROOT
from freeart21.code import modules_behind, source_digest

DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
LINE = re.compile(
    r"^\*Measured at `(?P<commit>[^`]+)`, of (?P<code>`[^`]+`(?:, `[^`]+`)*)(?: \(\[[^]]*\]\((?P<file>[^)]+)\)\))?: "
    r"(?P<state>old|current)\.\*(?=\\?$)",
    re.M,
)

MEASURED = {"reconstruct": ("reconstruct.pipeline", "reconstruct.features.hand_made", "reconstruct.trackers.dis")}
"""Package to the modules that its figures come from: what these do not import is left out. The defaults of registries
are found by name, so they are named."""


@dataclass(frozen=True)
class Stamp:
    """One such line: what it says, and what it ought to say."""

    line: str
    commit: str
    code: tuple[str, ...]
    right: str


def read_stamps(document: Path) -> list[Stamp]:
    """Every stamp of a document, in order."""
    found = []
    for match in LINE.finditer(document.read_text("utf-8")):
        file = match["file"] and (document.parent / match["file"]).resolve()
        commit = read_commit(file) if file else match["commit"]
        code = tuple(re.findall("`([^`]+)`", match["code"]))
        state = "current" if is_current(commit, code) else "old"
        right = match[0].replace(match["commit"], commit, 1).replace(f": {match['state']}.*", f": {state}.*")
        found.append(Stamp(match[0], commit, code, right))
    return found


def read_commit(results: Path) -> str:
    """The abbreviated commit that a file of benchmarks/results names; KeyError when it names none."""
    data = json.loads(results.read_text("utf-8"))
    commit = data["commit"] if "commit" in data else data["made_with"]["commit"]
    return commit if "-" in commit else commit[:7]


def is_current(commit: str, code: tuple[str, ...]) -> bool:
    """Whether no Python file of `code` (folders or files of the repository) does something else than at `commit`."""
    if _git("merge-base", "--is-ancestor", commit, "HEAD") is None:
        return False
    changed = _git("diff", "--name-only", "--no-renames", commit, "--", *code)
    return changed is not None and all(
        _same(commit, name) for name in changed.splitlines() if name.endswith(".py") and _is_measured(name)
    )


def _is_measured(name: str) -> bool:
    """Whether a Python file has a part in what its package's figures measure."""
    package = name.split("/")[0]
    return package not in MEASURED or not (ROOT / name).is_file() or name in _measured_files(package)


@cache
def _measured_files(package: str) -> frozenset[str]:
    """The files behind MEASURED[package], relative to the repository, and its __init__.py."""
    files = {ROOT / package / "__init__.py"}
    for module in MEASURED[package]:
        files |= set(modules_behind(module, ROOT, (package,)).values())
    return frozenset(file.relative_to(ROOT).as_posix() for file in files)


@cache
def _same(commit: str, name: str) -> bool:
    before, now = _git("show", f"{commit}:{name}"), ROOT / name
    return before is not None and now.is_file() and source_digest(before) == source_digest(now.read_text("utf-8"))


@cache
def _git(*words: str) -> str | None:
    """What git prints, None when it fails."""
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=False)
    return done.stdout if done.returncode == 0 else None


def main() -> None:
    """Print every stamp; with --write, correct those that are wrong."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--write", action="store_true", help="correct the lines in the documents")
    write = parser.parse_args().write
    for document in DOCUMENTS:
        text = document.read_text("utf-8")
        for stamp in read_stamps(document):
            state = "old" if stamp.right.endswith("old.*") else "current"
            says = "" if stamp.right == stamp.line else "  (the document says otherwise)"
            print(f"{document.name:16} {stamp.commit:14} {state:8} {', '.join(stamp.code)}{says}")
            text = text.replace(stamp.line, stamp.right)
        if write and text != document.read_text("utf-8"):
            document.write_text(text, "utf-8")


if __name__ == "__main__":
    main()
