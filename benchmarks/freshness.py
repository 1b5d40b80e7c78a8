"""Whether the figures that README and docs print are older than the code that they speak of.

A section that prints figures ends with a line such as

    *Measured at `84f6ef9`, of `reconstruct`, `leaderboard` ([file](../benchmarks/results/reconstruct.json)): old.*

It names the commit (that of the file, if one is named), the packages or files that the figures speak of, and says `old`
when what these do has changed since (`does_the_same`), `current` when it has not. A commit that this history does not
hold, or that had uncommitted changes, is old. A package of MEASURED is also current when `benchmarks.same_answers`
found that it gives the same answers as at that commit.

    python -m benchmarks.freshness            # prints a table
    python -m benchmarks.freshness --write    # corrects the lines in the documents
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import subprocess
import tarfile
import tempfile
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from types import CodeType
from typing import Any

from benchmarks.common import ROOT
from freeart21.code import code_digest, modules_behind, source_digest

DOCUMENTS = (ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md")))
LINE = re.compile(
    r"^\*Measured at `(?P<commit>[^`]+)`, of (?P<code>`[^`]+`(?:, `[^`]+`)*)(?: \(\[[^]]*\]\((?P<file>[^)]+)\)\))?: "
    r"(?P<state>old|current)\.\*(?=\\?$)",
    re.M,
)

MEASURED = {
    "reconstruct": (
        "reconstruct.pipeline",
        "reconstruct.features.hand_made",
        "reconstruct.pose_sources.tracked",
        "reconstruct.trackers.dis",
    ),
    "export": (
        "export.exporter",
        "export.check.checking",
        "export.check.engines.sapien_world",
        "export.check.engines.mujoco_world",
        "export.check.engines.pybullet_world",
        "export.check.engines.drake_world",
    ),
}
"""Package to the modules that its figures come from: what these do not import is left out. The defaults of registries
and of engines are found by name, so they are named."""

PROOFS = ROOT / "benchmarks" / "results" / "same_answers.json"
"""Pairs of versions of a package that were found to give the same answers, or not (`benchmarks.same_answers`)."""


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
    """Whether each of `code` (folders or files of the repository) does, or answers, what it did at `commit`."""
    if _git("merge-base", "--is-ancestor", commit, "HEAD") is None:
        return False
    return all(_is_unchanged(commit, name) or _gives_the_same(commit, name) for name in code)


def _is_unchanged(commit: str, place: str) -> bool:
    """Whether no Python file of a folder or file does something else than at `commit`."""
    changed = _git("diff", "--name-only", "--no-renames", commit, "--", place)
    return changed is not None and all(
        _same(commit, name)
        for name in changed.splitlines()
        if name.endswith(".py") and (place not in MEASURED or _is_measured(name))
    )


def _gives_the_same(commit: str, package: str) -> bool:
    """Whether a chain of proofs leads from `package` as it is to what it was at `commit`."""
    if package not in MEASURED or not PROOFS.is_file():
        return False
    equal = equal_digests(measured_digest(package, ROOT), json.loads(PROOFS.read_text("utf-8"))["proofs"])
    return len(equal) > 1 and digest_at(commit, package) in equal


def equal_digests(digest: str, proofs: list[dict[str, Any]]) -> set[str]:
    """All digests that proofs link to `digest`, itself with them.

    A pair that one proof found unequal is not linked, whatever another found.
    """
    links: dict[frozenset[str], bool] = {}
    for proof in proofs:
        pair = frozenset((proof["before"]["digest"], proof["after"]["digest"]))
        links[pair] = links.get(pair, True) and proof["equal"]
    found, waiting = {digest}, [digest]
    while waiting:
        here = waiting.pop()
        near = {other for pair, equal in links.items() if equal and here in pair for other in pair} - found
        found |= near
        waiting += near
    return found


@cache
def measured_digest(package: str, root: Path) -> str:
    """SHA-256, hexadecimal, of what a package of MEASURED does in a checkout."""
    return code_digest((name, root / name) for name in sorted(_measured_files(package, root)))


@cache
def digest_at(commit: str, package: str) -> str:
    """The `measured_digest` of a package at a commit; empty when git does not have it."""
    packed = subprocess.run(["git", "archive", commit, package], cwd=ROOT, capture_output=True, check=False)
    if packed.returncode:
        return ""
    with tempfile.TemporaryDirectory() as folder:
        with tarfile.open(fileobj=io.BytesIO(packed.stdout)) as archive:
            archive.extractall(folder, filter="data")
        return measured_digest(package, Path(folder))


def _is_measured(name: str) -> bool:
    """Whether a Python file of a package of MEASURED has a part in what its figures measure."""
    return not (ROOT / name).is_file() or name in _measured_files(name.split("/")[0], ROOT)


@cache
def _measured_files(package: str, root: Path) -> frozenset[str]:
    """The files behind MEASURED[package] in a checkout, relative to it, and its __init__.py."""
    files = {root / package / "__init__.py"}
    for module in MEASURED[package]:
        files |= set(modules_behind(module, root, (package,)).values())
    return frozenset(file.relative_to(root).as_posix() for file in files if file.is_file())


@cache
def _same(commit: str, name: str) -> bool:
    before, now = _git("show", f"{commit}:{name}"), ROOT / name
    return before is not None and now.is_file() and does_the_same(before, now.read_text("utf-8"))


def does_the_same(before: str, now: str) -> bool:
    """Whether two Python texts compile to the same instructions. Comments, docstrings, layout, and the names of local
    variables that are no arguments do not count."""
    if source_digest(before) == source_digest(now):
        return True
    return _instructions(before) == _instructions(now)


def _instructions(source: str) -> Any:
    tree = ast.parse(source)
    for node in ast.walk(tree):
        body = getattr(node, "body", None)
        if isinstance(body, list) and body:
            kept = [entry for entry in body if not _is_text(entry)]
            node.body = kept or [ast.copy_location(ast.Pass(), body[0])]  # type: ignore[attr-defined]
    return _read_code(compile(tree, "", "exec"))


def _is_text(entry: ast.stmt) -> bool:
    value = entry.value if isinstance(entry, ast.Expr) else None
    return isinstance(value, ast.Constant) and isinstance(value.value, str)


def _read_code(code: CodeType) -> tuple[Any, ...]:
    """What a code object does: instructions, global names, arguments, and constants with the code objects in them."""
    arguments = code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]
    constants = tuple(
        _read_code(each) if isinstance(each, CodeType) else (type(each).__name__, repr(each)) for each in code.co_consts
    )
    return code.co_name, code.co_code, code.co_names, arguments, code.co_flags, constants


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
