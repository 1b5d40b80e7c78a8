"""Do the tests find faults that matter? Plants small faults in a copy of the source, one at a time, and runs tests.

    .venv/bin/python -m benchmarks.planted_faults                # all faults
    .venv/bin/python -m benchmarks.planted_faults --names urdf-rpy-order pack-names

copies the tracked files to --work, replaces one short text there by a wrong one, and runs the test files that could
find it with `pytest -x`, a test that found it in an older run first. A fault counts as found when a test fails with it
and passes without it. Prints a table and writes benchmarks/results/planted_faults.json: a row a fault, with the test
that found it and seconds. Rows are cached in --work, keyed by fault and source: a stopped run continues. The JSON keeps
runs of other commits.

Whoever changes a line that `FAULTS` names updates its text here (tests/test_planted_faults.py).
"""

from __future__ import annotations

import hashlib
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import astuple, dataclass
from pathlib import Path
from typing import Any, TypeGuard

from benchmarks.common import RESULTS, ROOT, commit, machine, make_table, run_cli, wide_console
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked

SCHEMA = "freeart21/benchmark-planted-faults/1"
USAGE_ERROR = 4
"""Exit code of pytest, also for a test that is not found."""
LIMIT_S = 900.0
"""Seconds by the clock that the tests of one fault may take. A fault that makes them longer counts as found."""


@dataclass(frozen=True)
class Fault:
    """One wrong edit of the source, and the tests that could find it."""

    name: str
    file: str
    old: str
    """Found exactly once in the file."""
    new: str
    breaks: str
    """What goes wrong for a user."""
    tests: str
    """Names of test files without `test_` and `.py`, the likeliest to find it first."""

    @property
    def package(self) -> str:
        """Top folder of the file."""
        return self.file.split("/")[0]

    @property
    def test_files(self) -> list[str]:
        """Paths of the test files, relative to the repository."""
        return [f"tests/test_{name}.py" for name in self.tests.split()]


FAULTS = (
    # --- freeart21
    Fault(
        "joint-screw-moment",
        "freeart21/joint.py",
        "np.cross(self.pivot, self.axis)",
        "np.cross(self.axis, self.pivot)",
        "swapped argument: the screw of a hinge turns about the mirrored line",
        "joint effects",
    ),
    Fault(
        "camera-pixel-centre",
        "freeart21/camera.py",
        "np.arange(self.width) + 0.5 -",
        "np.arange(self.width) -",
        "frame convention: rays pass half a pixel left of the pixel centres",
        "camera metrics",
    ),
    Fault(
        "urdf-rpy-order",
        "freeart21/files/urdf.py",
        "se3.exp_so3(yaw * z) @ se3.exp_so3(pitch * y) @ se3.exp_so3(roll * x)",
        "se3.exp_so3(roll * x) @ se3.exp_so3(pitch * y) @ se3.exp_so3(yaw * z)",
        "frame convention: roll, pitch and yaw about moving axes",
        "urdf mesh_pieces",
    ),
    Fault(
        "urdf-mimic-offset",
        "freeart21/files/urdf.py",
        "shift + factor * offset",
        "shift + offset",
        "a joint that mimics a mimicking joint is put in a wrong place",
        "urdf check_geometry",
    ),
    Fault(
        "link-leads-out",
        "freeart21/files/checked.py",
        'if part == ".." or at.is_symlink():',
        'if part == "..":',
        "missing check: a link in a stranger's folder is followed out of it",
        "untrusted_files files",
    ),
    Fault(
        "output-inside-input",
        "freeart21/files/places.py",
        "given in place.parents and given != allowed and given.is_dir()",
        "False",
        "missing check: an output is written into the folder that is read",
        "places",
    ),
    Fault(
        "gaussian-quaternion-length",
        "freeart21/files/gaussians.py",
        "    quaternions /= lengths\n",
        "",
        "dropped normalisation: Gaussians of other programs keep quaternions of any length",
        "gaussians_file",
    ),
    Fault(
        "inertia-parallel-axis",
        "freeart21/mechanics.py",
        " + mass * arm @ arm",
        "",
        "the inertia about a hinge lacks mass times squared distance",
        "effects joint_asset simulate",
    ),
    Fault(
        "base-centrifugal-sign",
        "freeart21/base_motion.py",
        "np.cross(dw, joint.pivot) - np.cross(w, np.cross(w, joint.pivot))",
        "np.cross(dw, joint.pivot) + np.cross(w, np.cross(w, joint.pivot))",
        "sign: a hinge on a turning base is pulled inwards",
        "base_motion",
    ),
    Fault(
        "series-zero-unit",
        "freeart21/formats/measured_series.py",
        'q = sign * size_q * (values["q"] - settings.zero)',
        'q = sign * (size_q * values["q"] - settings.zero)',
        "unit: the zero of a recording in degrees is subtracted as radians",
        "measure_series measured_sources",
    ),
    Fault(
        "series-microseconds",
        "freeart21/formats/measured_series.py",
        '"us": 1e-6',
        '"us": 1e-3',
        "unit: times in microseconds are read as milliseconds",
        "measure_series position_units measured_sources",
    ),
    Fault(
        "trust-jump-scale",
        "freeart21/trust.py",
        'JUMP_ANGLE if joint.type == "revolute" else JUMP_SHARE * size',
        'JUMP_ANGLE if joint.type == "revolute" else JUMP_SHARE',
        "unit: a jump of a slider is compared with a share instead of metres",
        "trust",
    ),
    Fault(
        "job-digest-needs",
        "freeart21/jobs/job.py",
        "[digests[need] for need in job.needs]",
        "[need for need in job.needs]",
        "a job is not repeated after a job that it needs has changed",
        "jobs",
    ),
    # --- generator
    Fault(
        "sensor-frame-seed",
        "generator/sensor.py",
        "np.random.default_rng([self._seed, _STREAM, i])",
        "np.random.default_rng([self._seed, _STREAM])",
        "index: every frame has the same noise",
        "sensor",
    ),
    Fault(
        "tof-specimen-seed",
        "generator/tof.py",
        "np.random.default_rng([self.seed, 5])",
        "np.random.default_rng([5])",
        "a seed that is ignored: all time-of-flight cameras have the same systematic error",
        "sensor",
    ),
    Fault(
        "simulate-gravity-frame",
        "generator/simulate.py",
        "[:3, :3].T @ self.gravity",
        "[:3, :3] @ self.gravity",
        "frame convention: effects feel gravity turned the wrong way when the base is turned",
        "simulate effect_physics maniskill",
    ),
    Fault(
        "simulate-impact-time",
        "generator/simulate.py",
        "before = 2 * (limit - q) / (qd + impact)",
        "before = (limit - q) / (qd + impact)",
        "factor: the joint meets its limit after half the time",
        "simulate effect_physics surrogate",
    ),
    Fault(
        "track-rotation-order",
        "generator/motion/track.py",
        "R @ R[0].T @ R_first",
        "R[0].T @ R @ R_first",
        "frame convention: a take is replayed with its turns about the wrong axes",
        "track",
    ),
    Fault(
        "measure-gravity-frame",
        "generator/measure.py",
        "still[0, :3, :3].T @ np.array(",
        "still[0, :3, :3] @ np.array(",
        "frame convention: a measured set names gravity in a wrong frame",
        "measure",
    ),
    Fault(
        "query-turn-degrees",
        "generator/queries.py",
        "np.radians(TURN_DEGREES)",
        "TURN_DEGREES",
        "unit: held-out cameras turn by degrees taken as radians",
        "motion",
    ),
    Fault(
        "drive-epoch",
        "generator/teleop/driving.py",
        "        self.epoch += 1\n",
        "",
        "moves that a page sent before an undo undo the undo",
        "teleop",
    ),
    # --- reconstruct
    Fault(
        "kernel-moment-sign",
        "reconstruct/kernels.py",
        "b[3] += Y1 * m2 - Y2 * m1",
        "b[3] += Y1 * m2 + Y2 * m1",
        "sign: the gradient about x is wrong and poses converge slowly or not at all",
        "poses kernels hands",
    ),
    Fault(
        "normals-inwards",
        "reconstruct/surfaces.py",
        "np.cross(b - a, c - a)",
        "np.cross(c - a, b - a)",
        "sign: vertex normals look into the part",
        "surfaces",
    ),
    Fault(
        "state-unwrap",
        "reconstruct/joint.py",
        "return np.unwrap(turn)",
        "return turn",
        "states of a wide hinge jump by a whole turn",
        "joint_estimation",
    ),
    Fault(
        "scene-pixel-centre",
        "reconstruct/scene.py",
        "(K[0, 2] - origin[:, 0] - offset - 0.5) / factor",
        "(K[0, 2] - origin[:, 0] - offset) / factor",
        "frame convention: all points are half a pixel to the side",
        "labels hands diagnostics surfaces",
    ),
    Fault(
        "window-block-centre",
        "reconstruct/gaussians/windows.py",
        "((factor - 1) // 2, factor // 2)",
        "(factor // 2, factor // 2)",
        "off by one: depth of a window sampled down is half a pixel off",
        "gaussian_windows",
    ),
    Fault(
        "exchange-mirror",
        "reconstruct/part_swaps.py",
        "2 * turning - poses.states",
        "turning - poses.states",
        "states of swapped parts are mirrored about the wrong state",
        "part_swaps",
    ),
    Fault(
        "adam-bias",
        "reconstruct/gaussians/adam.py",
        "one - beta2 ** steps[n]",
        "one - beta1 ** steps[n]",
        "swapped constant: first steps of the Gaussians are thirty times too small",
        "gaussian_model",
    ),
    # --- export
    Fault(
        "shell-inertia",
        "export/inertia.py",
        "9 * area / 12",
        "area / 12",
        "factor: the inertia of a thin-walled part is too small",
        "export",
    ),
    Fault(
        "origin-euler-axes",
        "export/urdf.py",
        'as_euler("xyz")',
        'as_euler("XYZ")',
        "frame convention: primitives of an asset are turned about moving axes",
        "export_solid",
    ),
    Fault(
        "mjcf-inertia-order",
        "export/mjcf.py",
        "number_text(xx, yy, zz, xy, xz, yz)",
        "number_text(xx, yy, zz, xy, yz, xz)",
        "swapped argument: products of inertia in the MJCF are exchanged",
        "export_solid losses export",
    ),
    Fault(
        "asset-axis-of-root",
        "export/placement.py",
        '-in_root.axis if root == "moving" else in_root.axis',
        "in_root.axis",
        "axis sign: an asset that stands on its moving part turns the wrong way",
        "placement export",
    ),
    Fault(
        "asset-state-zero",
        "export/placement.py",
        "0.0 - zero",
        "0.0 + zero",
        "sign: asset.json says the opposite joint position for canonical state zero",
        "placement export",
    ),
    Fault(
        "inertia-triangle",
        "export/inertia.py",
        "if a + b < c * (1 - 1e-6):",
        "if a + b < 0:",
        "missing check: inertia that no body has is shipped and passes check-asset",
        "export check_asset",
    ),
    Fault(
        "pendulum-period",
        "export/joint_asset.py",
        "numbers.period / (2 * math.pi)",
        "numbers.period / math.pi",
        "factor: a pendulum of a period is four times as long",
        "joint_asset",
    ),
    # --- leaderboard
    Fault(
        "align-at-origin",
        "leaderboard/metrics.py",
        "se3.mean_pose(Ts @ T_pred_centred) @ se3.inverse(T_pred_centred)",
        "se3.mean_pose(Ts)",
        "frame convention: the score depends on where a method has its origin",
        "metrics strict1",
    ),
    Fault(
        "missing-number-unpriced",
        "leaderboard/sequence_score.py",
        "found.values.get(id, penalty)",
        "found.values.get(id)",
        "a failure that is not priced: what an answer lacks is left out of the mean",
        "score strict1 submission",
    ),
    Fault(
        "range-price-degrees",
        "leaderboard/protocols/strict1.py",
        "float(np.rad2deg(motion))",
        "float(motion)",
        "unit: missing states of a hinge cost radians among degrees",
        "score strict1 strict2 lacks",
    ),
    Fault(
        "archive-path-out",
        "leaderboard/archive.py",
        '".." in name.parts or ',
        "",
        "missing check: a ZIP of results writes outside the folder it is unpacked to",
        "files submission_fuzz untrusted_files pack",
    ),
    Fault(
        "parts-swapped-axis",
        "leaderboard/matching.py",
        "axis=-joint.axis",
        "axis=joint.axis",
        "axis sign: an answer with its parts named the other way is scored as turning backwards",
        "strict1 strict2 score",
    ),
    Fault(
        "sample-deviation",
        "leaderboard/score.py",
        "float(column.std())",
        "float(column.std(ddof=0))",
        "off by one: standard deviations are those of a population",
        "score compare",
    ),
    Fault(
        "pack-names",
        "leaderboard/pack.py",
        "f\"seq-{keyed(f'sequence {name}')[:12]}\"",
        'f"seq-{name}"',
        "the public half of a hidden benchmark names the objects",
        "pack",
    ),
    Fault(
        "screwsplat-scale",
        "leaderboard/adapters/screwsplat.py",
        "scale * np.cross(w, v)",
        "np.cross(w, v)",
        "unit: the axis of an imported ScrewSplat result is not scaled to metres",
        "adapters",
    ),
    # --- simgap
    Fault(
        "kernel-late-sensor",
        "simgap/models/kernel.py",
        "times[0] - p[READING_DELAY]",
        "times[0] + p[READING_DELAY]",
        "sign: a late sensor is simulated as an early one",
        "surrogate",
    ),
    Fault(
        "mujoco-gravity-frame",
        "simgap/prove/replay_process.py",
        "se3.inverse(self.asset.T_canonical_reference)[:3, :3]",
        "self.asset.T_canonical_reference[:3, :3]",
        "frame convention: gravity points elsewhere in MuJoCo where the reference link is turned",
        "replay base_motion drives",
    ),
    Fault(
        "body-turn-sign",
        "simgap/prove/body.py",
        "-float(np.angle(is_now / was))",
        "float(np.angle(is_now / was))",
        "sign: the centre of mass of a repaired asset is turned the wrong way",
        "gap_proof",
    ),
    Fault(
        "base-turned-back",
        "simgap/measure/base_motion.py",
        "se3.exp_so3(-angle[:, None] * axis)",
        "se3.exp_so3(angle[:, None] * axis)",
        "frame convention: gravity turns the wrong way as seen from a turning base",
        "base_motion",
    ),
    Fault(
        "confirming-runs-fitted",
        "simgap/select/split.py",
        "[run for run in order if run not in confirming]",
        "list(order)",
        "runs that confirm a verdict were fitted before",
        "gap_fit gap_choose",
    ),
    Fault(
        "film-focal-sign",
        "simgap/film/geometry.py",
        '"focal_length": (-along, ',
        '"focal_length": (along, ',
        "sign: a wrong focal length is not named, or with the wrong sign",
        "film_gap",
    ),
    Fault(
        "mjcf-old-spring",
        "simgap/prove/writeback.py",
        '"armature", "stiffness", "springref"',
        '"armature"',
        "a repaired MJCF keeps a spring that its effects no longer have",
        "gap_proof losses gap_show",
    ),
    Fault(
        "floor-quantum",
        "simgap/measure/noise.py",
        "step**2 / 12",
        "step**2 / 1200",
        "factor: the noise of a coarse encoder is taken for a tenth of what it is",
        "gap_fit measured",
    ),
)


def main(
    names: tuple[str, ...] = (),
    limit_s: float = LIMIT_S,
    work: Path = ROOT / "out" / "planted_faults",
    out: Path | None = None,
) -> None:
    """Plant each fault and run its tests.

    Args:
        names: These faults alone.
        limit_s: Seconds by the clock that the tests of one fault may take.
        work: Where the copy of the source, compiled kernels and finished rows are kept.
        out: The JSON file. When not given: benchmarks/results/planted_faults.json, and only when no names are given.
    """
    known = {fault.name: fault for fault in FAULTS}
    for name in names:
        if name not in known:
            raise FreeArtError(f"there is no fault '{name}'; faults: {', '.join(known)}")
    console, source = wide_console(), tracked_files()
    digest = _digest_of(source)
    tree = copy_source(source, work / "tree")
    path = out or (None if names else RESULTS / "planted_faults.json")
    known_runs = path or RESULTS / "planted_faults.json"
    older = checked.read_json(known_runs, SCHEMA, checked.ANYWHERE)["runs"] if known_runs.is_file() else []
    finders = {row["name"]: row["test"] for run in older for row in run["rows"] if row["status"] == "found"}
    rows = []
    for fault in [known[name] for name in names] or FAULTS:
        rows.append(_row(fault, tree, work, digest, limit_s, finders.get(fault.name)))
        console.print(f"{fault.name}: {_outcome(rows[-1])}", highlight=False)
    missed_first = sorted(rows, key=lambda row: row["status"] == "found")
    cells = [(r["name"], r["package"], r["status"], r["test"] or "", f"{r['seconds']:.0f}") for r in missed_first]
    head = ("fault", "package", "status", "test", "s")
    console.print(make_table("planted faults", head, cells, texts=("package", "status", "test")))
    console.print(_counts(rows))
    if path is None:
        return
    run = {
        "commit": commit(),
        "summary": _summary(rows),
        "rows": rows,
        "settings": {"limit_s": limit_s},
        "machine": machine(),
    }
    atomic.write_json(path, {"schema": SCHEMA, "runs": [*(r for r in older if r["commit"] != run["commit"]), run]})
    console.print(str(path))


def tracked_files(root: Path = ROOT) -> dict[str, bytes]:
    """Path to content of every tracked file of the repository, as it is in the working tree."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, check=True).stdout.decode()
    return {name: (root / name).read_bytes() for name in listed.split("\0") if name and (root / name).is_file()}


def _digest_of(source: dict[str, bytes]) -> str:
    """SHA-256 of all Python files but this one."""
    digest = hashlib.sha256()
    for name, content in sorted(source.items()):
        if name.endswith(".py") and Path(name).name not in (Path(__file__).name, f"test_{Path(__file__).name}"):
            digest.update(name.encode() + b"\0" + content)
    return digest.hexdigest()


def copy_source(source: dict[str, bytes], tree: Path) -> Path:
    """Make the folder `tree` hold exactly these files. Unchanged ones keep their times, and so compiled code stays."""
    for path in sorted(tree.rglob("*"), reverse=True) if tree.is_dir() else ():
        is_cache = "__pycache__" in path.parts
        if path.is_file() and not is_cache and path.relative_to(tree).as_posix() not in source:
            path.unlink()
    for name, content in source.items():
        path = tree / name
        if not path.is_file() or path.read_bytes() != content:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
    return tree


def plant(fault: Fault, tree: Path) -> None:
    """Replace the fault's text in its file; FreeArtError unless it is found exactly once."""
    path = tree / fault.file
    text = path.read_text("utf-8")
    if (times := text.count(fault.old)) != 1:
        raise FreeArtError(f"{fault.name}: {fault.file} has its text {times} times, expected once: {fault.old!r}")
    path.write_text(text.replace(fault.old, fault.new), "utf-8")


def _row(
    fault: Fault, tree: Path, work: Path, digest: str, limit_s: float, finder: str | None = None
) -> dict[str, Any]:
    """What the tests say of one fault, `finder` (a test that found it before) first; a cached row when there is one."""
    cached = work / "rows" / f"{fault.name}.json"
    key = hashlib.sha256(repr((astuple(fault), digest)).encode()).hexdigest()
    if cached.is_file() and (known := checked.read_json(cached, SCHEMA)).get("key") == key:
        return dict(known["row"])
    path = tree / fault.file
    content, facts = path.read_bytes(), path.stat()
    began = time.monotonic()
    try:
        plant(fault, tree)
        # Numba's cached kernels do not notice changes of kernels that they call
        compiled = "fresh" if b"njit" in content else "kernels"
        shutil.rmtree(work / "fresh", ignore_errors=True)
        test, message = run_tests([finder], tree, work, compiled, limit_s) if _exists(finder, tree) else (None, "")
        if test is None:
            test, message = run_tests(fault.test_files, tree, work, compiled, limit_s)
    finally:
        path.write_bytes(content)
        os.utime(path, ns=(facts.st_atime_ns, facts.st_mtime_ns))
    seconds = time.monotonic() - began
    status = "missed" if test is None else "found"
    if test and "::" in test:
        again, _ = run_tests([test], tree, work, "kernels", limit_s)
        status = "found" if again is None else "fails without it"
    row = {
        "name": fault.name,
        "package": fault.package,
        "file": fault.file,
        "breaks": fault.breaks,
        "status": status,
        "test": test,
        "message": message,
        "tests": fault.tests.split(),
        "seconds": round(seconds, 1),
    }
    atomic.write_json(cached, {"schema": SCHEMA, "key": key, "row": row})
    return row


def _exists(test: str | None, tree: Path) -> TypeGuard[str]:
    """Whether a test of this name is still in its file."""
    file, _, name = (test or "").partition("::")
    path = tree / file
    return bool(name) and path.is_file() and f"def {name.split('[')[0]}(" in path.read_text("utf-8")


def run_tests(tests: list[str], tree: Path, work: Path, compiled: str, limit_s: float) -> tuple[str | None, str]:
    """The first test that fails, None when all pass, and its message; of the test files or tests `tests` in `tree`.

    `compiled` names the folder of Numba's cached kernels. Tests that take more than `limit_s` seconds count as failed.
    """
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-rfE", "--tb=no", "--no-header", "-p", "no:cacheprovider"]
    settings = {"PYTHONPATH": str(tree), "NUMBA_CACHE_DIR": str(work / compiled), "COLUMNS": "400"}
    settings["PYTEST_DISABLE_PLUGIN_AUTOLOAD"] = "1"  # no test needs a plugin, and they take half of the start
    with tempfile.TemporaryDirectory(prefix="freeart21-") as place, (Path(place) / "output").open("w+b") as output:
        process = subprocess.Popen(
            [*command, f"--basetemp={place}/tests", *tests],
            cwd=tree,
            env={**os.environ, **settings},
            stdin=subprocess.DEVNULL,
            stdout=output,
            stderr=output,
            start_new_session=True,
        )
        try:
            code = process.wait(limit_s)
        except subprocess.TimeoutExpired:
            return "no end", f"no end within {limit_s:g} s"
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        output.seek(0)
        text = output.read().decode(errors="replace")
    if code == 0:
        return None, ""
    if code == USAGE_ERROR and "::" in tests[0]:  # the test has other parameters now
        return None, ""
    match = re.search(r"^(?:FAILED|ERROR) (.+?)(?: - (.*))?$", text, re.M)
    if match is None:
        raise FreeArtError(f"pytest {' '.join(tests)} ended with {code}: {text.strip()[-500:]}")
    return match[1], (match[2] or "")[:200]


def _outcome(row: dict[str, Any]) -> str:
    by = f" by {row['test']}" if row["test"] else ""
    return f"{row['status']}{by} ({row['seconds']:.0f} s)"


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    packages = sorted({row["package"] for row in rows})
    counts = {p: [row["status"] == "found" for row in rows if row["package"] == p] for p in packages}
    return {
        "faults": len(rows),
        "found": sum(row["status"] == "found" for row in rows),
        "by_package": {p: {"faults": len(found), "found": sum(found)} for p, found in counts.items()},
        "missed": [row["name"] for row in rows if row["status"] != "found"],
        "seconds": round(sum(row["seconds"] for row in rows), 1),
    }


def _counts(rows: list[dict[str, Any]]) -> str:
    summary = _summary(rows)
    missed = f"; missed: {', '.join(summary['missed'])}" if summary["missed"] else ""
    return f"{summary['found']} of {summary['faults']} faults found{missed}"


if __name__ == "__main__":
    run_cli(main)
