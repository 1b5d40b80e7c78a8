"""Any URDF or MJCF, checked: a sound little asset passes every rule, and each broken one fails its own rule."""

from __future__ import annotations

import importlib.util
import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import trimesh
from command_line import run_command
from little_asset import numbers, write_little
from refusal import assert_refused

from export.check import checking, trial_process
from export.check.checking import check
from export.check.engines.base import MODULES, load_world
from export.check.file_rules import judge_files
from export.check.report import Row
from export.check.rules import ENGINE_RULES, FILE_RULES, MAX_HULLS
from export.check.subject import find_subject
from export.check.trial import Trial
from export.check.trial_process import run_stage

REAL = Path(__file__).resolve().parents[2] / "shared"
mujoco_only = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="MuJoCo is not installed")


def files_of(path: Path, facts: dict | None = None) -> list[Row]:
    subject = find_subject(path)
    return list(
        judge_files(subject.urdf, subject.mjcf, subject.folder, {} if facts is None else facts, lambda rule: None)
    )


def trial_of(path: Path) -> list[Row]:
    """The rows of a trial in MuJoCo, in this process."""
    subject, facts = find_subject(path), {}
    list(judge_files(subject.urdf, subject.mjcf, subject.folder, facts, lambda rule: None))
    from export.check.trial_process import _read_tree

    load = partial(load_world, "mujoco", subject.mjcf or subject.urdf, subject.folder)
    return list(Trial("mujoco", _read_tree(subject.urdf, subject.mjcf), facts["lowest"], load).rows(lambda rule: None))


def failed(rows: list[Row]) -> list[str]:
    return [row.rule for row in rows if row.verdict == "fail"]


# ---------------------------------------------------------------- what is sound


@pytest.mark.parametrize("kg", [0.02, 30.0])
def test_a_sound_asset_passes_every_rule_in_every_engine_whatever_it_weighs(tmp_path: Path, kg: float):
    installed = [engine for engine in ("sapien", "mujoco") if importlib.util.find_spec(MODULES[engine])]
    report = check(write_little(tmp_path / "lid", kg).parent, installed)
    assert report.verdict == "pass" and {row.rule for row in report.rows if row.engine == "file"} == set(FILE_RULES)
    for engine in installed:
        rows = [row for row in report.rows if row.engine == engine]
        assert {row.rule for row in rows} == set(ENGINE_RULES)
        assert {row.verdict for row in rows} == {"pass"}, engine
        assert report.engines[engine] and report.settings[engine] and report.seconds[engine] < 60


@pytest.mark.parametrize("engine", ["pybullet", "drake"])
def test_a_sound_asset_passes_in_engines_that_few_have(tmp_path: Path, engine: str):
    pytest.importorskip(MODULES[engine])
    report = check(write_little(tmp_path / "lid"), [engine])
    assert report.verdict == "pass" and {row.verdict for row in report.rows if row.engine == engine} == {"pass"}


@mujoco_only
def test_a_sound_mjcf_passes(tmp_path: Path):
    rows = [*files_of(write_little(tmp_path, mjcf=True)), *trial_of(tmp_path)]
    assert failed(rows) == [] and all(row.verdict == "pass" for row in rows if row.engine == "mujoco")


# ---------------------------------------------------------------- what is broken in the files

LIGHT = '<inertial><mass value="0.01"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/></inertial>'
WELD = '<joint name="weld" type="fixed"><parent link="{0}"/><child link="{1}"/></joint></robot>'
LID_COLLISION = '<collision name="lid_collision"><origin xyz="0.1 0 0.005"/><geometry><box size="0.2 0.15 0.01"/>'
TEXT_BREAKS: dict[str, tuple[str, str]] = {
    "tree.links-exist": ("</robot>", WELD.format("box", "ghost")),
    "tree.one-root": ("</robot>", '<link name="alone"/></robot>'),
    "tree.one-parent": ("</robot>", WELD.format("box", "lid")),
    "names.unique": ('name="lid_visual"', 'name="box_visual"'),
    "inertia.present": ('<inertial><origin xyz="0.1', '<nothing/><no_inertial><origin xyz="0.1'),
    "inertia.physical": ('mass value="0.1"', 'mass value="-0.1"'),
    "inertia.centre-inside": ('<inertial><origin xyz="0.1 0 0.005"/>', '<inertial><origin xyz="0.1 0 0.2"/>'),
    "axis.unit": ('axis xyz="0 -1 0"', 'axis xyz="0 -2 0"'),
    "limits.present": ('<limit lower="0" upper="1.2" effort="10" velocity="5"/>', ""),
    "limits.ordered": ('lower="0" upper="1.2"', 'lower="1.2" upper="0"'),
    "limits.zero-within": ('lower="0" upper="1.2"', 'lower="0.1" upper="1.2"'),
    "limits.effort": ('effort="10"', 'effort="0"'),
    "limits.velocity": ('velocity="5"', 'velocity="0"'),
    "dynamics.damped": ("<dynamics", "<no_dynamics"),
    "collision.present": ("collision", "no_collision"),
    "collision.few": (LID_COLLISION, "".join(f'<collision name="c{k}"/>' for k in range(MAX_HULLS)) + LID_COLLISION),
    "numbers and meshes": ('axis xyz="0 -1 0"', 'axis xyz="0 minus 0"'),
}


def broken(folder: Path, rule: str) -> Path:
    file = write_little(folder)
    text, (old, new) = file.read_text(), TEXT_BREAKS[rule]
    assert old in text
    if rule == "inertia.present":
        head, _, tail = text.partition(old)
        text = head + new + tail.replace("</inertial>", "</no_inertial>", 1)
    elif rule == "collision.present":
        head, _, tail = text.partition('<link name="lid">')
        text = head + '<link name="lid">' + tail.replace(old, new)
    else:
        text = text.replace(old, new, 1)
    file.write_text(text)
    return file


@pytest.mark.parametrize("rule", TEXT_BREAKS)
def test_each_break_of_the_text_fails_its_rule_and_no_other(tmp_path: Path, rule: str):
    assert failed(files_of(broken(tmp_path, rule))) == [rule]


def with_meshes(folder: Path, solid: trimesh.Trimesh | None = None) -> Path:
    """The little asset with a mesh for its lid, seen and touched, and a material for it."""
    file = write_little(folder)
    solid = solid or trimesh.creation.box((0.2, 0.15, 0.01))
    body = "".join("v {:.6f} {:.6f} {:.6f}\n".format(*v) for v in solid.vertices)
    body += "".join("f {} {} {}\n".format(*(f + 1)) for f in solid.faces)
    (folder / "hull.obj").write_text(body)
    (folder / "seen.obj").write_text("mtllib seen.mtl\n" + body)
    (folder / "seen.mtl").write_text("newmtl plain\nKd 1 0 0\n")
    text = file.read_text()
    head, _, tail = text.partition('<link name="lid">')
    for name in ("seen", "hull"):
        tail = tail.replace('<box size="0.2 0.15 0.01"/>', f'<mesh filename="{name}.obj"/>', 1)
    file.write_text(head + '<link name="lid">' + tail)
    return file


def replaced(name: str, old: str, new: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new, 1))

    return change


def first_face_lost(name: str) -> Callable[[Path], None]:
    def change(folder: Path) -> None:
        lines = (folder / name).read_text().splitlines()
        k = next(k for k, line in enumerate(lines) if line.startswith("f "))
        (folder / name).write_text("\n".join(lines[:k] + lines[k + 1 :]))

    return change


FILE_BREAKS: dict[str, Callable[[Path], None]] = {
    "paths.relative": replaced("lid_box.urdf", '"seen.obj"', '"package://lid/seen.obj"'),
    "paths.exist": lambda folder: (folder / "hull.obj").unlink(),
    "textures.exist": lambda folder: (folder / "seen.mtl").unlink(),
    "collision.closed": first_face_lost("hull.obj"),
    "mesh.watertight": first_face_lost("seen.obj"),
    "mesh.readable": lambda folder: (folder / "seen.obj").write_text("nothing"),
}


@pytest.mark.parametrize("rule", FILE_BREAKS)
def test_each_break_of_a_file_fails_its_rule_and_no_other(tmp_path: Path, rule: str):
    with_meshes(tmp_path)
    FILE_BREAKS[rule](tmp_path)
    assert failed(files_of(tmp_path)) == [rule]


# ---------------------------------------------------------------- what an engine does with it


def tilted(folder: Path) -> Path:
    """Leant over by 0.5 rad about x, on the edge of its base."""
    file = write_little(folder)
    root = f'<link name="base">{LIGHT}</link>'
    joint = f'<origin xyz="0 0 {0.075 * np.sin(0.5)}" rpy="0.5 0 0"/></joint></robot>'
    weld = WELD.format("base", "box").replace("</joint></robot>", joint)
    file.write_text(file.read_text().replace("</robot>", f"{root}{weld}"))
    return file


def blocked(folder: Path) -> Path:
    """A ledge welded to the box, 5 mm over the lid's far end."""
    file = write_little(folder)
    ledge = f'<link name="ledge">{LIGHT}'
    for tag in ("visual", "collision"):
        ledge += f'<{tag}><origin xyz="0.08 0 0.06"/><geometry><box size="0.04 0.1 0.01"/></geometry></{tag}>'
    file.write_text(file.read_text().replace("</robot>", f"{ledge}</link>{WELD.format('box', 'ledge')}"))
    return file


def write_both(folder: Path, old: str, new: str, flat: bool = False) -> Path:
    """The URDF with an MJCF next to it that says something else; `flat`: both hinges stand upright."""
    urdf, file = write_little(folder), write_little(folder, mjcf=True)
    for one in (urdf, file) if flat else ():
        one.write_text(one.read_text().replace('"0 -1 0"', '"0 0 1"'))
    text = file.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    return folder


DAMPING = f'damping="{numbers(0.5)["damping"]}"'
TRIALS: dict[str, Callable[[Path], Path]] = {
    "engine.tree": partial(write_both, old='body name="lid"', new='body name="cover"'),
    "engine.limits": partial(write_both, old='range="0 1.2"', new='range="0 1.19"'),
    "engine.masses": partial(write_both, old=f'mass="{numbers(0.5)["lid"]}"', new='mass="0.11"'),
    "engine.poses": partial(write_both, old='axis="0 -1 0"', new='axis="0 -1 0.001"'),
    "joint.moves": blocked,
    "joint.stops": partial(write_both, old='name="hinge"', new='name="hinge" solreflimit="2 1"', flat=True),
    "energy.falls": partial(write_both, old=DAMPING, new='damping="-0.003"'),
    "rest.drift": tilted,
}


@mujoco_only
@pytest.mark.parametrize("rule", TRIALS)
def test_each_break_of_the_dynamics_fails_its_rule_and_no_other(tmp_path: Path, rule: str):
    assert failed(trial_of(TRIALS[rule](tmp_path))) == [rule]


@pytest.mark.parametrize(
    "body, verdict, message",
    [
        ("import os; os.abort()", "fail", "signal 6"),
        ("import time; time.sleep(60)", "unknown", "took more than 3 s"),
        ("while True: pass", "unknown", "took more than 2 s of processor time"),
    ],
)
def test_an_engine_that_crashes_fails_one_that_needs_longer_is_unknown(
    tmp_path: Path, body: str, verdict: str, message: str, monkeypatch: pytest.MonkeyPatch
):
    """A stand-in for SAPIEN, found in its place by the process of the trial."""
    place = tmp_path / "site"
    place.mkdir()
    (place / "sapien.py").write_text(body)
    urdf = write_little(tmp_path / "lid")
    monkeypatch.syspath_prepend(place)
    monkeypatch.setattr(trial_process, "WALL", 1.5 if "sleep" in body else 60)
    answer = run_stage({"engine": "sapien", "folder": str(urdf.parent), "urdf": str(urdf), "lowest": 0.0}, 2.0)
    first, *others = answer.rows
    assert (first.rule, first.verdict) == ("engine.loads", verdict) and message in first.reason
    assert {row.rule for row in others} == set(ENGINE_RULES) - {"engine.loads"}
    assert {row.verdict for row in others} == {"unknown" if verdict == "unknown" else "skip"}


# ---------------------------------------------------------------- what is unusual, and right

WORLD = (
    '<link name="world"/><joint name="mount" type="fixed"><parent link="world"/><child link="box"/>{0}</joint></robot>'
)
FRAME = '<link name="tip"/><joint name="t" type="fixed"><parent link="lid"/><child link="tip"/></joint></robot>'
COMPILER = (
    '<mujoco><compiler fusestatic="true" meshdir="away" balanceinertia="true"/><option integrator="RK4"/></mujoco>'
    '<link name="box">'
)
KEY = '<keyframe><key qpos="0 0 0 1 0 0 0 0.1"/></keyframe></mujoco>'
UNUSUAL: dict[str, tuple[bool, str, str]] = {
    "on a wall": (False, "</robot>", WORLD.format('<origin xyz="0.1 0 1.2" rpy="0 0 1"/>')),
    "a frame without mass": (False, "</robot>", FRAME),
    "a footprint": (False, "</robot>", WORLD.format("").replace("world", "footprint")),
    "words for MuJoCo": (False, '<link name="box">', COMPILER),
    "a keyframe": (True, "</mujoco>", KEY),
}


@mujoco_only
@pytest.mark.parametrize("name", UNUSUAL)
def test_what_is_unusual_and_right_passes(tmp_path: Path, name: str):
    mjcf, old, new = UNUSUAL[name]
    file = write_little(tmp_path, mjcf=mjcf)
    assert old in file.read_text()
    file.write_text(file.read_text().replace(old, new))
    assert failed([*files_of(file), *trial_of(file)]) == []


# ---------------------------------------------------------------- what is no asset


def test_what_is_no_asset_costs_one_line(tmp_path: Path):
    (tmp_path / "notes.txt").write_text("mine")
    for path, message in (
        (tmp_path, "is no asset"),
        (tmp_path / "notes.txt", "is no asset"),
        (tmp_path / "x", "not exist"),
    ):
        assert_refused(message, check, path)
    write_little(tmp_path / "a")
    assert_refused("no engine 'gazebo'; engines: sapien, mujoco", check, tmp_path / "a", ["gazebo"])
    (tmp_path / "a" / "second.urdf").write_text('<robot name="b"/>')
    assert_refused(r"name one of lid_box\.urdf, second\.urdf", check, tmp_path / "a")


BOMB = '<!DOCTYPE r [<!ENTITY a "aaaa"><!ENTITY b "&a;&a;&a;">]><{0} name="&b;"/>'


@pytest.mark.parametrize("tag, name", [("robot", "a.urdf"), ("mujoco", "a.xml")])
def test_a_bomb_is_refused_before_anything_is_read(tmp_path: Path, tag: str, name: str):
    (tmp_path / name).write_text(BOMB.format(tag))
    assert_refused("declares a document type", check, tmp_path)


@pytest.mark.parametrize("name", ["/etc/passwd.obj", "../other/lid.obj", "file:///etc/passwd.obj"])
def test_a_file_outside_is_refused(tmp_path: Path, name: str):
    file = with_meshes(tmp_path / "a")
    file.write_text(file.read_text().replace("hull.obj", name))
    assert_refused("out of the folder", check, file)
    mjcf = write_little(tmp_path / "m", mjcf=True)
    mjcf.write_text(mjcf.read_text().replace("<worldbody>", f'<asset><mesh file="{name}"/></asset><worldbody>'))
    if "://" not in name:
        assert_refused("out of the folder", check, mjcf)


# ---------------------------------------------------------------- the command


def test_the_command_says_what_failed_and_ends_with_its_code(tmp_path: Path, monkeypatch, capsys):
    monkeypatch.setattr(checking, "ENGINES", ())
    file = write_little(tmp_path / "lid")
    assert run_command(capsys, "check-asset", file.parent, "--json", tmp_path / "said.json")[0] == 0
    document = json.loads((tmp_path / "said.json").read_text())
    assert (
        document["schema"] == "freeart21/check/1"
        and document["verdict"] == "pass"
        and len(document["rows"]) == len(FILE_RULES)
    )
    assert document["rules"]["axis.unit"] == {
        "asks": "joint axes have unit length",
        "good_for": FILE_RULES["axis.unit"].good_for,
    }
    code, out, _ = run_command(capsys, "check-asset", broken(tmp_path / "bad", "axis.unit").parent)
    assert code == 3 and "fail  axis.unit (file): joint 'hinge' has an axis of length 2, expected 1" in out
    assert "expected seconds" in run_command(capsys, "check-asset", file, "--limit-s", "nan")[2]
    _, out, err = run_command(capsys, "check-asset", file, "--json", file / "said.json")
    assert "cannot write" in err and out.endswith("in time: 0\n"), "what was found is not lost"


# ---------------------------------------------------------------- data of others


@pytest.mark.skipif(not (REAL / "urdf_objects" / "laptop").is_dir(), reason="the real objects are not on this machine")
def test_a_real_laptop_moves_and_is_not_blamed_for_our_settings(tmp_path: Path):
    rows = files_of(REAL / "urdf_objects" / "laptop" / "laptop.urdf")
    assert failed(rows) == ["collision.convex", "dynamics.damped", "stands.on-ground"]
    if importlib.util.find_spec("mujoco"):
        trial = trial_of(REAL / "urdf_objects" / "laptop" / "laptop.urdf")
        assert failed(trial) == ["rest.drift"]  # it stands on edge, its lid open
