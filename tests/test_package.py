"""What an installed package holds besides code: the marks of types, and the pages' and benchmarks' own files."""

import subprocess
from fnmatch import fnmatch
from pathlib import Path

import pytest
from conftest import QUICK

try:
    import tomllib
except ModuleNotFoundError:  # Python 3.10
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("freeart21", "generator", "reconstruct", "export", "leaderboard", "simgap")
SETUPTOOLS = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]


def is_shipped(file: Path) -> bool:
    """Whether setuptools puts this file of a package, such as freeart21/py.typed, into a wheel.

    Folders without __init__.py are packages, too: `packages.find` looks for namespaces by default.
    """
    found = SETUPTOOLS["packages"]["find"]
    package = ".".join(file.parent.parts)
    if not any(fnmatch(package, pattern) for pattern in found["include"]) or not found.get("namespaces", True):
        return False
    return file.suffix == ".py" or any(fnmatch(file.name, glob) for glob in SETUPTOOLS["package-data"]["*"])


@pytest.mark.parametrize("package", PACKAGES)
def test_a_package_says_that_it_is_typed(package):
    assert (ROOT / package / "py.typed").is_file() and is_shipped(Path(package, "py.typed"))


def test_every_tracked_file_of_a_package_is_shipped():
    tracked = subprocess.run(["git", "ls-files", *PACKAGES], capture_output=True, text=True, cwd=ROOT)
    if tracked.returncode:
        pytest.skip("not a git checkout")
    files = [Path(line) for line in tracked.stdout.splitlines()]
    assert {file.suffix for file in files} >= {".py", ".js", ".css", ".json"}
    assert [str(file) for file in files if not is_shipped(file)] == []


def test_what_no_pattern_names_is_left_out():
    assert not is_shipped(Path("freeart21/view/static/picture.svg")) and not is_shipped(Path("docs/page.html"))


def test_the_quick_tests_are_there():
    assert [name for name in QUICK if not (ROOT / "tests" / f"test_{name}.py").is_file()] == []
