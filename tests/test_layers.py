"""Imports point down, and no method can import a truth."""

import ast
import functools
import graphlib
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
PACKAGES = ("generator", "reconstruct", "export", "leaderboard", "simgap", "baselines")
HEAVY = {"sapien", "torch", "mani_skill", "open3d", "mujoco", "coacd", "trimesh", "scipy", "plotly", "skimage", "numba"}
ALLOWED = {  # what a package may import from other packages
    "generator": set(),
    "reconstruct": set(),
    # for ManiSkill the second makes the catalog's objects, the third builds them in GPU scenes, which give no state
    "export": {"generator.simulate", "generator.object_folder", "generator.sapien_asset"},
    "leaderboard": {"generator.simulate", "export.checklist"},
    "simgap": {"generator.simulate", "export"},
    "freeart21": set(),
    "baselines": set(),  # as anybody's method: the ground alone; but `paper` ends with our poses and surfaces
}
TRUTH_HOLDERS = {
    "freeart21.truth",
    "freeart21.files.truth",
    "freeart21.files.benchmark",
    "freeart21.catalog",
    "freeart21.formats",
    "freeart21.cli",
    "freeart21.view",
}


parse = functools.cache(ast.parse)


def imports(source: str) -> list[tuple[str, bool]]:
    """(module, at module level) of every import; `from a import b` gives both a and a.b."""
    tree = parse(source)
    top = {id(node) for node in tree.body}
    found = []
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            found += [(alias.name, id(node) in top) for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module:
            found += [(node.module, id(node) in top)] + [
                (f"{node.module}.{a.name}", id(node) in top) for a in node.names
            ]
    return found


def _on_one_path(module: str, entry: str) -> bool:
    """Whether `module` is `entry`, in it, or a package on the way to it."""
    return f"{module}.".startswith(f"{entry}.") or f"{entry}.".startswith(f"{module}.")


def faults(package: str, source: str, wraps_library: bool = False) -> list[str]:
    """Forbidden imports of a package; `wraps_library`: for a module that subclasses a heavy library."""
    wrong = []
    for module, at_top in imports(source):
        head = module.split(".")[0]
        if head in PACKAGES and head != package and not any(_on_one_path(module, entry) for entry in ALLOWED[package]):
            wrong.append(f"{package} imports {module}")
        if package in ("reconstruct", "baselines") and any(
            module == t or module.startswith(t + ".") for t in TRUTH_HOLDERS
        ):
            wrong.append(f"{package} imports {module}, which holds a truth")
        if package == "freeart21" and head in HEAVY and at_top:
            wrong.append(f"freeart21 imports {head} at the top of a module")
        if head in ("sapien", "torch", "mani_skill", "open3d") and at_top and not wraps_library:
            wrong.append(f"{package} imports {head} at the top of a module")
    return wrong


def _wraps_library(path):
    """Whether a module is imported only where its library is wanted: ManiSkill's classes, and check-asset's engines."""
    classes = path.parent == ROOT / "export" / "maniskill" and path.name.startswith("_") and path.stem != "__init__"
    return classes or (path.parent == ROOT / "export" / "check" / "engines" and path.stem.endswith("_world"))


@pytest.mark.parametrize("package", [*PACKAGES, "freeart21"])
def test_imports_point_down(package):
    for path in (ROOT / package).rglob("*.py"):
        if path != ROOT / "freeart21" / "cli.py":
            found = faults(package, path.read_text(), _wraps_library(path))
            by_ours = package == "baselines" and path.stem.startswith("paper")
            assert not [fault for fault in found if not (by_ours and "imports reconstruct" in fault)], path


@pytest.mark.parametrize(
    "package, planted",
    [
        ("reconstruct", "from freeart21.truth import Truth"),
        ("reconstruct", "def f():\n    from freeart21.files import truth"),
        ("reconstruct", "import generator.simulate"),
        ("export", "from leaderboard import metrics"),
        ("baselines", "from reconstruct.rigid import view_angle"),
        ("freeart21", "import trimesh"),
        ("generator", "import sapien"),
    ],
)
def test_a_planted_import_is_found(package, planted):
    assert faults(package, planted)


def test_the_checklist_is_asked_only_where_assets_are_loaded_in_a_process_of_their_own():
    for path in (ROOT / "leaderboard").rglob("*.py"):
        at_tops = [at_top for module, at_top in imports(path.read_text()) if module.startswith("export")]
        assert not any(at_tops) and bool(at_tops) == (path.name == "asset_measurement.py"), path
    source = (ROOT / "leaderboard" / "asset_measurement.py").read_text()
    (function,) = [
        f for f in ast.walk(ast.parse(source)) if isinstance(f, ast.FunctionDef) and f.name == "_examine_asset"
    ]
    assert "export.checklist" in {module for module, _ in imports(ast.unparse(function))}


def test_help_needs_nothing_heavy():
    code = (
        "import sys; sys.argv = ['freeart21', '--help']\n"
        "from freeart21 import cli\n"
        "try: cli.main()\n"
        "except SystemExit: pass\n"
        f"print([m for m in {sorted(HEAVY | {'cv2', 'numpy'})} if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT)
    assert done.stdout.strip().endswith("[]"), done.stdout[-300:]


def test_no_modules_import_each_other_in_a_circle():
    files = {p: p.relative_to(ROOT).with_suffix("").as_posix() for r in ALLOWED for p in (ROOT / r).rglob("*.py")}
    names = {name.removesuffix("/__init__").replace("/", "."): path for path, name in files.items()}
    graph = {}
    for name, path in names.items():
        nodes = list(ast.walk(parse(path.read_text())))
        typing_only = {
            id(child)
            for node in nodes
            if isinstance(node, ast.If) and isinstance(node.test, ast.Name) and node.test.id == "TYPE_CHECKING"
            for child in node.body
        }
        found = set()
        for node in nodes:
            if isinstance(node, ast.ImportFrom) and node.module and id(node) not in typing_only:
                members = (f"{node.module}.{alias.name}" for alias in node.names)
                found |= {member if member in names else node.module for member in members}
            elif isinstance(node, ast.Import):
                found |= {alias.name for alias in node.names}
        graph[name] = {module for module in found if module in names and module != name}
    graphlib.TopologicalSorter(graph).prepare()  # CycleError names the circle
