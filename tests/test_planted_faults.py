"""The table of planted faults fits the source: whoever changes a line that it names updates it there."""

from __future__ import annotations

import ast
from dataclasses import replace
from pathlib import Path

import pytest

from benchmarks import planted_faults
from benchmarks.planted_faults import FAULTS, ROOT, copy_source, plant, run_tests
from freeart21.errors import FreeArtError

FAULT = FAULTS[0]


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_changes_one_place_of_the_source_and_names_tests_that_exist(fault):
    text = (ROOT / fault.file).read_text("utf-8")
    assert text.count(fault.old) == 1, f"{fault.file}: update `{fault.name}` in benchmarks/planted_faults.py"
    broken = ast.dump(ast.parse(text.replace(fault.old, fault.new)))
    assert broken != ast.dump(ast.parse(text)), "it changes a comment or the layout"
    assert fault.tests and all((ROOT / name).is_file() for name in fault.test_files)


def test_faults_cover_all_packages():
    assert len({fault.name for fault in FAULTS}) == len(FAULTS) >= 40
    assert {fault.package for fault in FAULTS} == {
        "freeart21", "generator", "reconstruct", "export", "leaderboard", "simgap",
    }  # fmt: skip


def test_a_fault_is_planted_once_and_a_copy_is_restored(tmp_path: Path):
    source = {"a.py": b"x = 1 + 2\n", "sub/b.py": b""}
    tree = copy_source(source, tmp_path / "tree")
    fault = replace(FAULT, file="a.py", old="1 + 2", new="1 - 2")
    plant(fault, tree)
    assert (tree / "a.py").read_text() == "x = 1 - 2\n"
    with pytest.raises(FreeArtError, match="0 times"):
        plant(fault, tree)
    (tree / "old.py").write_text("")
    copy_source(source, tree)
    assert {path.relative_to(tree).as_posix() for path in tree.rglob("*.py")} == set(source)
    assert (tree / "a.py").read_bytes() == source["a.py"]


def test_a_fault_counts_as_found_when_a_test_fails_with_it_alone(tmp_path: Path):
    source = {
        "a.py": b"x = 1 + 2\n",
        "tests/test_a.py": b"import a\n\ndef test_x():\n    assert a.x == 3\n",
        "tests/test_b.py": b"import a\n\ndef test_y():\n    assert a.x\n",
    }
    tree, fault = copy_source(source, tmp_path / "tree"), replace(FAULT, file="a.py", old="1 + 2", new="1 - 2")
    found, missed = (
        planted_faults._row(replace(fault, name=tests, tests=tests), tree, tmp_path, "", 60.0) for tests in "ab"
    )
    assert (found["status"], found["test"]) == ("found", "tests/test_a.py::test_x")
    assert (missed["status"], missed["test"]) == ("missed", None)
    again = planted_faults._row(replace(fault, tests="b"), tree, tmp_path, "", 60.0, "tests/test_a.py::test_x")
    assert again["test"] == "tests/test_a.py::test_x", "a test that found it before is run first"
    gone = planted_faults._row(replace(fault, tests="b"), tree, tmp_path, "1", 60.0, "tests/test_a.py::test_x[old]")
    assert gone["status"] == "missed"
    assert run_tests(["tests/test_a.py"], tree, tmp_path, "kernels", 60.0) == (None, ""), "the source is restored"
    with pytest.raises(FreeArtError, match="ended with 4"):
        run_tests(["tests/test_none.py"], tree, tmp_path, "kernels", 60.0)
