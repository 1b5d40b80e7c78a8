"""No process of ours imports what lies in the folder that the user stands in."""

import os
import subprocess
from pathlib import Path

import pytest
from another_python import ROOT, run_python
from little_asset import write_little

from freeart21 import processes, search_path

TRAPS = ("queue", "numpy", "json", "signal", "random", "cv2", "multiprocessing", "sitecustomize", "pickle", "sapien")


def trapped(folder: Path) -> Path:
    """A folder whose modules say on being imported that they were; the file that would hold it."""
    folder.mkdir(exist_ok=True)
    marker = folder / "imported.txt"
    for name in TRAPS:
        (folder / f"{name}.py").write_text(f"open({str(marker)!r}, 'a').write('{name}\\n')\nraise SystemExit(9)\n")
    return marker


@pytest.mark.parametrize("variables", [{}, {"PYTHONPATH": f":{ROOT}"}, {"PYTHONPATH": f"{ROOT}:."}])
def test_a_child_does_not_import_from_the_working_folder(tmp_path, monkeypatch, variables):
    marker = trapped(tmp_path / "user")
    monkeypatch.chdir(tmp_path / "user")
    monkeypatch.syspath_prepend("")
    monkeypatch.syspath_prepend(str(tmp_path / "user"))  # as `python -m` puts it
    code = "import queue, json, numpy, sys; print(numpy.__name__, sys.argv[1])"
    done = subprocess.run(
        [*processes.python(code), "word"], env={**os.environ, **variables}, capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.returncode) == ("numpy word\n", 0), done.stderr
    assert not marker.exists()


def test_the_command_does_not_import_from_the_working_folder(tmp_path):
    """Not even by `python -m`, which puts it first; but what Python imports before it begins with us is Python's."""
    marker = trapped(tmp_path / "user")
    done = run_python("-m", "freeart21", "objects", "--json", cwd=tmp_path / "user")
    assert done.returncode == 0, done.stderr
    assert not marker.exists(), marker.read_text()


def _check_asset(folder: Path) -> list[list[str]]:
    write_little(folder / "little")
    return [["check-asset", "little/lid_box.urdf"]]


def _record(folder: Path) -> list[list[str]]:
    small = ["--frames", "2", "--queries", "0", "--width", "64", "--height", "36", "--shader", "trivial"]
    return [["record", "stapler", "flip_lighter", "--workers", "2", *small, "--out", "made"]]


@pytest.mark.parametrize("prepare", [_check_asset, _record])
def test_no_command_runs_what_lies_in_its_folder(tmp_path, prepare):
    commands = prepare(tmp_path)
    marker = trapped(tmp_path)
    for words in commands:
        done = run_python("-m", "freeart21", *words, cwd=tmp_path)
        assert done.returncode in (0, 3), done.stderr
        assert not marker.exists(), (words, marker.read_text())


def test_packages_of_the_same_names_elsewhere_are_not_imported(tmp_path):
    (tmp_path / "export").mkdir()
    (tmp_path / "export" / "__init__.py").write_text("raise SystemExit(9)\n")
    command = ["-m", "freeart21", "joint-asset", "--mass", "1", "--length", "0.1", "--out", str(tmp_path / "p.urdf")]
    done = run_python(*command, PYTHONPATH=os.pathsep.join([str(tmp_path), str(ROOT)]))
    assert done.returncode == 0 and (tmp_path / "p.urdf").is_file(), done.stderr


def test_a_package_that_another_project_replaced_is_named(tmp_path, monkeypatch):
    assert search_path.replaced_package() is None
    monkeypatch.setattr(search_path, "_ROOT", str(tmp_path))
    fault = search_path.replaced_package()
    assert fault.startswith(f"package generator: {tmp_path / 'generator'} is not FreeArt-21's (no recorder.py)")
