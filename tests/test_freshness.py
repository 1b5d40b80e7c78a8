"""Figures in the documents name their commit, and those that are older than their code say so."""

import re
import subprocess
from pathlib import Path

import pytest

from benchmarks import freshness, results
from benchmarks.freshness import DOCUMENTS, LINE, ROOT, is_current, read_stamps

MEASURED = ("README", "adapters", "assets", "maniskill", "priors", "recorder", "results", "scale", "simgap", "teleop")
"""Documents whose tables of figures are measurements; the others' tables are definitions."""
in_git = pytest.mark.skipif(not (ROOT / ".git").exists(), reason="not a clone: no commits to compare with")


@in_git
@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_figures_older_than_their_code_are_marked(document: Path):
    for stamp in read_stamps(document):
        assert stamp.line == stamp.right, "python -m benchmarks.freshness --write"
        assert all((ROOT / name).exists() for name in stamp.code), stamp.line


@in_git
@pytest.mark.parametrize("document", results.DOCUMENTS, ids=lambda path: path.name)
def test_the_solver_s_tables_are_those_of_the_files(document: Path):
    assert results.fill(document) == document.read_text("utf-8"), "python -m benchmarks.results --write"
    assert results.TABLE.search(document.read_text("utf-8"))


def numeric_share(section: str) -> float:
    """The share of table cells that begin with a number."""
    rows = [line.strip("| ").split("|") for line in section.splitlines() if line.startswith("|")]
    cells = [cell.strip(" *") for row in rows for cell in row[1:]]
    return sum(bool(re.match(r"[\d.]*\d", cell)) for cell in cells) / max(len(cells), 1)


@pytest.mark.parametrize("document", [d for d in DOCUMENTS if d.stem in MEASURED], ids=lambda path: path.name)
def test_every_table_of_figures_names_its_commit(document: Path):
    for section in re.split(r"^#+ ", document.read_text("utf-8"), flags=re.M):
        if numeric_share(section) > 0.3:
            assert LINE.search(section), f"{document.name}, '{section.splitlines()[0]}': figures without a commit"


@pytest.fixture
def history(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """A repository with one commit of `code/a.py`; gives its folder and that commit."""

    def git(*words: str) -> str:
        settings = ("-c", "user.name=a", "-c", "user.email=a@b.c")
        return subprocess.run(
            ["git", *settings, *words], cwd=tmp_path, check=True, capture_output=True, text=True
        ).stdout.strip()

    git("init", "-q")
    (tmp_path / "code").mkdir()
    (tmp_path / "code" / "a.py").write_text('"""Old."""\nx = 1\n')
    git("add", ".")
    git("commit", "-qm", "one")
    monkeypatch.setattr(freshness, "ROOT", tmp_path)
    freshness._git.cache_clear()
    freshness._same.cache_clear()
    yield tmp_path, git("rev-parse", "--short", "HEAD")
    freshness._git.cache_clear()
    freshness._same.cache_clear()


@pytest.mark.parametrize(
    ("name", "text", "current"),
    [
        ("a.py", '"""Old."""\nx = 1\n', True),
        ("a.py", '"""New words."""\n\n# a comment\nx = (1)\n', True),
        ("a.py", '"""Old."""\nx = 2\n', False),
        ("b.md", "words", True),
    ],
)
def test_only_what_code_does_makes_figures_old(history, name, text, current):
    folder, commit = history
    (folder / "code" / name).write_text(text)
    assert is_current(commit, ("code",)) is current


def test_a_removed_file_makes_figures_old(history):
    folder, commit = history
    (folder / "code" / "a.py").unlink()
    assert not is_current(commit, ("code",))


@pytest.mark.parametrize("commit", ["deadbee", "HEAD-dirty"])
def test_a_commit_that_is_not_in_the_history_is_old(history, commit):
    assert not is_current(commit, ("code",))


def test_what_the_solver_never_reaches_makes_no_figure_old():
    inside = {f"reconstruct/{name}.py" for name in ("__init__", "joint", "trackers/dis", "features/hand_made")}
    every = {file.relative_to(ROOT).as_posix() for file in (ROOT / "reconstruct" / "gaussians").glob("*.py")}
    assert all(map(freshness._is_measured, inside | every))
    assert not freshness._is_measured("reconstruct/look.py") and freshness._is_measured("leaderboard/look.py")
