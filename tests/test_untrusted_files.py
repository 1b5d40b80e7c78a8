"""Files of users are opened in one place, `freeart21.files.checked`, whatever they are."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("freeart21", "generator", "export", "leaderboard", "simgap", "reconstruct")
OPENERS = {
    *("open", "fdopen", "imread", "imdecode", "fromfile", "read_bytes", "read_text", "loadtxt", "genfromtxt", "memmap"),
    *("copyfile", "copytree", "copy2", "ZipFile", "VideoCapture", "loadmat", "load_mesh"),
}
"""Calls of these names, of whatever they are, open or read a file."""
OF_MODULES = {"np.load", "json.load", "json.loads", "trimesh.load", "shutil.copy", "ET.parse", "h5py.File"}
WRITES = {"w", "wb", "xb", "a"}
OWN_CHILD = "the answer of a process of our own"
OWN_SOURCE = "our own source"
RESOURCE = "a file of the package"
OWN_LOCK = "a lock of ours, which is written"
DEVICE = "a device"
OWN_ASIDE = "what this process has just written, in a folder of its own"
FROM_MEMORY = "bytes that `checked` has read"
EXEMPT = {
    ("freeart21/code.py", "read_text"): OWN_SOURCE,
    ("leaderboard/suite/plan.py", "read_text"): OWN_SOURCE,
    ("simgap/motion/laws.py", "read_bytes"): OWN_SOURCE,
    ("simgap/workflow.py", "read_bytes"): OWN_SOURCE,
    ("freeart21/view/document.py", "read_text"): RESOURCE,
    ("generator/teleop/server.py", "read_text"): RESOURCE,
    ("leaderboard/site/html.py", "read_text"): RESOURCE,
    ("export/loaders/__init__.py", "read_bytes"): RESOURCE,
    ("freeart21/doctor.py", "json.loads"): OWN_CHILD,
    ("freeart21/formats/mat_file.py", "json.loads"): OWN_CHILD,
    ("freeart21/jobs/work.py", "json.loads"): OWN_CHILD,
    ("generator/teleop/stage_process.py", "json.loads"): OWN_CHILD,
    ("export/check/trial_process.py", "json.loads"): OWN_CHILD,
    ("leaderboard/asset_process.py", "json.loads"): OWN_CHILD,
    ("leaderboard/asset_process.py", "fdopen"): OWN_CHILD,
    ("leaderboard/worker.py", "json.loads"): OWN_CHILD,
    ("leaderboard/worker.py", "fdopen"): OWN_CHILD,
    ("leaderboard/site/packed.py", "json.loads"): "bytes of a page that this process has just made",
    ("generator/teleop/wire.py", "json.loads"): "a message of the page, of bounded length",
    ("freeart21/formats/mat_file.py", "loadmat"): FROM_MEMORY,
    ("freeart21/files/mesh_file.py", "loadtxt"): FROM_MEMORY,
    ("freeart21/view/link_shapes.py", "load_mesh"): FROM_MEMORY,
    ("generator/urdf_folder.py", "load_mesh"): FROM_MEMORY,
    ("export/usd.py", "read_bytes"): OWN_ASIDE,
    ("leaderboard/site/build.py", "read_bytes"): OWN_ASIDE,
    ("leaderboard/archive.py", "open"): "an entry of an archive that `checked` has opened",
    ("leaderboard/provenance.py", "read_text"): "/proc/cpuinfo",
    ("simgap/proof/show.py", "read_text"): OWN_ASIDE,
    ("freeart21/jobs/work.py", "open"): "the log of a job of ours",
    ("leaderboard/asset_process.py", "open"): "the log of a process of our own, and a device",
    ("freeart21/ending.py", "open"): DEVICE,
    ("leaderboard/worker.py", "open"): DEVICE,
    ("freeart21/files/lock.py", "open"): OWN_LOCK,
    ("generator/dataset.py", "open"): OWN_LOCK,
}
"""Module and call to why it may open something itself. What `checked.require_file` has looked at needs no entry."""
STANDALONE = "export/loaders/load_"
"""Scripts that are copied into assets, to run without this package."""


def openings(source: str) -> list[str]:
    """The calls in `source` that read a file; not those that write one or take a path that was looked at."""
    found = []
    for node in ast.walk(ast.parse(source)):
        if not isinstance(node, ast.Call):
            continue
        name = ast.unparse(node.func)
        last = name.rpartition(".")[2]
        if name.startswith("checked.") or not (last in OPENERS or name in OF_MODULES):
            continue
        words = [argument for argument in (*node.args, *(k.value for k in node.keywords))]
        modes = {word.value for word in words if isinstance(word, ast.Constant) and isinstance(word.value, str)}
        looked_at = node.args and ast.unparse(node.args[0]).startswith("checked.require_file(")
        if not ((modes & WRITES and last in ("open", "File", "ZipFile", "fdopen")) or looked_at):
            found.append(last if last in OPENERS else name)
    return found


def test_every_file_of_a_user_is_opened_by_the_one_module_that_checks_it():
    found = set()
    for package in PACKAGES:
        for path in sorted((ROOT / package).rglob("*.py")):
            name = path.relative_to(ROOT).as_posix()
            if name != "freeart21/files/checked.py" and not name.startswith(STANDALONE):
                found |= {(name, call) for call in openings(path.read_text())}
    assert not found - set(EXEMPT), "open it by freeart21.files.checked"
    assert not set(EXEMPT) - found, "no longer needed"


@pytest.mark.parametrize(
    "planted",
    [
        "cv2.imread(str(path))",
        "json.loads(path.read_text())",
        "json.load(file)",
        "np.load(path)",
        "np.fromfile(path)",
        "Image.open(path)",
        "open(path)",
        "path.open('rb')",
        "path.read_bytes()",
        "shutil.copytree(a, b)",
        "zipfile.ZipFile(path)",
        "h5py.File(path, 'r')",
    ],
)
def test_a_planted_opening_is_found(planted):
    assert openings(f"def f(path):\n    return {planted}")
    assert not openings("path.open('wb').write(data)\ntrimesh.load_mesh(checked.require_file(path, 1))")
