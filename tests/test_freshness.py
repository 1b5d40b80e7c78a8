"""Figures in the documents name their commit, and those that are older than their code say so."""

import json
import re
import subprocess
from pathlib import Path

import pytest
from refusal import assert_refused

from benchmarks import freshness, results, same_answers
from benchmarks.freshness import DOCUMENTS, LINE, ROOT, is_current, read_stamps
from leaderboard.suite.workflow import Outcome

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


def test_reference_rows_are_scored_by_the_protocol_of_all_rows(data, tmp_path, monkeypatch):
    """The suite's own protocol was another one by then."""
    monkeypatch.setattr(results, "RESULTS", tmp_path)
    rows = {"truth": [{"group": "revolute", "failures": 0}]}

    def run(suite, workers):
        return Outcome({protocol: rows for protocol in suite.plan.protocols}, (), ())

    monkeypatch.setattr(results, "run_suite", run)
    results.score_references(data, tmp_path / "suite", 1)
    written = json.loads((tmp_path / results.REFERENCES).read_text())
    assert written["settings"]["protocol"] == "strict-2"
    assert written["rows"] == {"truth": {"revolute": rows["truth"][0]}}


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
    clear_caches()
    yield tmp_path, git("rev-parse", "--short", "HEAD")
    clear_caches()


def clear_caches() -> None:
    for function in ("_git", "_same", "_measured_files", "measured_digest", "digest_at"):
        getattr(freshness, function).cache_clear()


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


def proof(before: str, after: str, equal: bool) -> dict:
    return {"before": {"digest": before}, "after": {"digest": after}, "equal": equal}


def test_proofs_chain_and_one_unequal_outweighs_others():
    chain = [proof("a", "b", True), proof("c", "b", True), proof("d", "e", True)]
    assert freshness.equal_digests("a", chain) == {"a", "b", "c"}
    for order in (1, -1):
        assert freshness.equal_digests("a", [*chain, proof("b", "a", False)][::order]) == {"a"}


def test_figures_are_current_by_proofs_of_the_same_answers(history, monkeypatch):
    """The proof must speak of this commit's code and of the code as it is; another package's is none."""
    folder, commit = history
    monkeypatch.setattr(freshness, "MEASURED", {"code": ("code.a",)})
    monkeypatch.setattr(freshness, "PROOFS", folder / "proofs.json")
    before = freshness.measured_digest("code", folder)
    assert freshness.digest_at(commit, "code") == before

    def current_with(*proofs):
        freshness.PROOFS.write_text(json.dumps({"proofs": proofs}))
        clear_caches()
        return is_current(commit, ("code",))

    (folder / "code" / "a.py").write_text("import code.b\nx = 2\n")
    (folder / "code" / "b.py").write_text("y = 1\n")
    clear_caches()
    assert not is_current(commit, ("code",))
    after = freshness.measured_digest("code", folder)
    assert not current_with(proof(before, "other", True))
    assert not current_with(proof(before, after, False))
    assert current_with(proof(before, "other", True), proof("other", after, True))
    assert not is_current(commit, ("code/a.py",))
    (folder / "code" / "b.py").write_text("y = 2\n")
    assert not current_with(proof(before, after, True))


@pytest.fixture
def answers(tmp_path):
    """Two result folders of the same answer, solved at another time by another version."""
    folders = tmp_path / "before", tmp_path / "after"
    for k, folder in enumerate(folders):
        (folder / "parts").mkdir(parents=True)
        (folder / "parts" / "moving.ply").write_bytes(b"ply")
        settings = {"solver": str(k), "joint": {"weight": 0.2, **({"new": 1} if k else {})}}
        answer = {"states": [0.0, float("nan")], "seconds": {"joint": k}, "settings": settings}
        (folder / "prediction.json").write_text(json.dumps(answer))
        (folder / "diagnostics.json").write_text(json.dumps({"peak_bytes": k, "footprint_m": 0.1}))
    return folders


def test_answers_are_compared_but_for_times_memory_and_version(answers):
    assert same_answers.compare_results(*answers) == ([], 3)


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("parts/moving.ply", "ply", "plY"),
        ("parts/moving.ply", "ply", None),
        ("prediction.json", "NaN", "0.0"),
        ("prediction.json", "0.2", "0.3"),
        ("diagnostics.json", "0.1", "0.10000000000000002"),
    ],
)
@pytest.mark.parametrize("side", [0, 1])
def test_what_differs_between_two_answers_is_found(answers, side, name, old, new):
    file = answers[side] / name
    if new is None:
        file.unlink()
    else:
        assert old in file.read_text()
        file.write_text(file.read_text().replace(old, new))
    assert same_answers.compare_results(*answers) == ([name], 3)


def test_a_proof_of_the_same_code_and_seed_is_replaced(tmp_path):
    file = tmp_path / "proofs.json"
    for seed, equal in ((1, True), (2, True), (1, False)):
        same_answers.add_proof({**proof("a", "b", equal), "seed": seed}, file)
    found = json.loads(file.read_text())
    assert [(each["seed"], each["equal"]) for each in found["proofs"]] == [(2, True), (1, False)]
    assert found["left_out"]["diagnostics.json"] == ["peak_bytes"]


def test_failures_alone_prove_nothing():
    def solves(**statuses):
        return [{"settings": name, "status": status, "differing": []} for name, status in statuses.items()]

    good = solves(geometry="ok", default="ok", paper="ok")
    assert same_answers.judge([*good, *solves(geometry="failed")]) is True
    assert same_answers.judge(solves(geometry="ok", default="failed", paper="ok")) is None
    assert same_answers.judge([*good, {**good[0], "differing": ["poses.npz"]}]) is False


def test_a_tree_with_changes_proves_nothing(monkeypatch):
    monkeypatch.setattr(same_answers.common, "commit", lambda: "abc-dirty")
    assert_refused("commit first", same_answers.main, "HEAD")


@pytest.mark.parametrize(
    ("now", "same"),
    [
        (
            'def f(a, *, b=2):\n    """Other text."""\n    kept = a * b\n    return [kept + k for k in (1, 2)] #\n',
            True,
        ),
        ('def f(a, *, c=2):\n    """Text."""\n    found = a * c\n    return [found + k for k in (1, 2)]\n', False),
        ('def f(a, *, b=2):\n    """Text."""\n    found = a + b\n    return [found + k for k in (1, 2)]\n', False),
        ('def f(a, *, b=2):\n    """Text."""\n    found = a * b\n    return [found + k for k in (1, 3)]\n', False),
        ('def f(a, *, b=2):\n    """Text."""\n    found = g * b\n    return [found + k for k in (1, 2)]\n', False),
        ('def f(a, *, b=3):\n    """Text."""\n    found = a * b\n    return [found + k for k in (1, 2)]\n', False),
    ],
)
def test_names_of_local_variables_make_no_figure_old(now, same):
    before = 'def f(a, *, b=2):\n    """Text."""\n    found = a * b\n    return [found + k for k in (1, 2)]\n'
    assert freshness.does_the_same(before, now) is same
