"""The Dockerfile and the workflow name only what is there: there is no Docker to build it with in the tests."""

import json
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LINES = [
    line
    for line in (ROOT / "Dockerfile").read_text().replace("\\\n", " ").splitlines()
    if line and not line.startswith("#")
]


def arguments(instruction: str) -> list[str]:
    return [line.split(maxsplit=1)[1] for line in LINES if line.split()[0] == instruction]


def test_the_image_has_a_python_and_a_debian_that_the_setup_knows():
    (image,) = arguments("FROM")
    version, debian = re.fullmatch(r"python:(\d\.\d+)-slim-(\w+)", image).groups()
    setup = (ROOT / "scripts/setup.sh").read_text()
    assert f"python{version}" in setup and debian in setup


def test_what_the_image_runs_is_copied_and_executable():
    scripts = [run for run in arguments("RUN") if run.startswith("scripts/")]
    assert scripts == ["scripts/setup.sh"] and (ROOT / scripts[0]).stat().st_mode & 0o111
    ignored = (ROOT / ".dockerignore").read_text().split()
    for needed in ("scripts", "pyproject.toml", "constraints.txt", "README.md", "LICENSE", "Makefile", "freeart21"):
        assert (ROOT / needed).exists() and needed not in ignored
    assert arguments("COPY") == [". ."] and "make" in " ".join(arguments("RUN")).split()


def test_the_default_command_is_the_demo():
    (command,) = arguments("CMD")
    make, target = json.loads(command)
    assert make == "make" and target == "demo"
    assert re.search(rf"^{target}:", (ROOT / "Makefile").read_text(), re.M)


def test_the_workflow_calls_the_script_that_is_there():
    workflow = (ROOT / ".github/workflows/ci.yml").read_text()
    assert re.search(r"run: \.ci/run$", workflow, re.M) and (ROOT / ".ci/run").stat().st_mode & 0o111


def test_pre_commit_has_the_ruff_that_is_pinned():
    pinned = re.search(r'^ruff==(\S+) ; python_version >= "3.11"$', (ROOT / "constraints.txt").read_text(), re.M)
    assert f"rev: v{pinned[1]}\n" in (ROOT / ".pre-commit-config.yaml").read_text()
