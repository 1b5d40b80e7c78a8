"""Rules of shapes: what is seen against what is touched, inertia against size, parts that pass through each other."""

from pathlib import Path

import numpy as np
import pytest
import trimesh

from export.check.file_rules import judge_files
from export.check.solids import make_body
from export.check.subject import find_subject

REAL = Path(__file__).resolve().parents[2] / "shared"
BOX = '<origin xyz="{at}"/><geometry><box size="{size}"/></geometry>'
CABINET = """<robot name="cabinet">
<link name="body"><inertial><origin xyz="0 0 0.2"/><mass value="5"/>
  <inertia ixx="0.15" ixy="0" ixz="0" iyy="0.15" iyz="0" izz="0.15"/></inertial>
  <visual><origin xyz="0 0 0.2"/><geometry><box size="0.4 0.4 0.4"/></geometry></visual>
  <collision><origin xyz="0 0 0.2"/><geometry><box size="0.4 0.4 0.4"/></geometry></collision></link>
<link name="door"><inertial><origin xyz="0 0.2 0"/><mass value="1"/>
  <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.02"/></inertial>
  <visual><origin xyz="0 0.2 0"/><geometry><box size="0.02 0.4 0.36"/></geometry></visual>
  <collision><origin xyz="0 0.2 0"/><geometry><box size="0.02 0.4 0.36"/></geometry></collision></link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/><origin xyz="0.211 -0.2 0.2"/>
  <axis xyz="0 0 -1"/><limit lower="0" upper="1.5" effort="10" velocity="5"/>
  <dynamics damping="0.05" friction="0.02"/></joint>
</robot>"""
DOOR_SEEN = '<visual><origin xyz="0 0.2 0"/>'
DOOR_TOUCHED = '<collision><origin xyz="0 0.2 0"/>'
DOOR_BOX = '<geometry><box size="0.02 0.4 0.36"/></geometry>'
INERTIA = 'ixx="0.02" ixy="0" ixz="0" iyy="0.012" iyz="0" izz="0.02"'
KNOB = f"</visual><visual>{BOX.format(at='0.04 0.35 0', size='0.06 0.03 0.03')}</visual>{DOOR_TOUCHED}"


def failed(folder: Path, text: str) -> dict[str, str]:
    """Rule to reason, of the rules of the files that fail."""
    file = folder / "cabinet.urdf"
    file.write_text(text)
    subject = find_subject(file)
    rows = judge_files(subject.urdf, subject.mjcf, subject.folder, {}, lambda rule: None)
    return {row.rule: row.reason for row in rows if row.verdict == "fail"}


def changed(old: str, new: str) -> str:
    assert old in CABINET
    return CABINET.replace(old, new, 1)


def test_a_sound_cabinet_passes(tmp_path: Path):
    assert failed(tmp_path, CABINET) == {}


SHIFTED = '<collision><origin xyz="{}"/>'
MATCHES, CLEAR, FITS = "collision.matches-visual", "parts.clear", "inertia.fits-shape"
BREAKS = {
    "a visual in mm": ("0.4 0.4 0.4", "400 400 400", MATCHES),
    "a collision in cm": (
        DOOR_TOUCHED + DOOR_BOX,
        DOOR_TOUCHED + DOOR_BOX.replace("0.02 0.4 0.36", "2 40 36"),
        MATCHES,
    ),
    "a collision that lies higher": (DOOR_TOUCHED, SHIFTED.format("0 0.2 0.1"), MATCHES),
    "a thin door beside its visual": (DOOR_TOUCHED, SHIFTED.format("0.03 0.2 0"), MATCHES),
    "a collision turned over": (DOOR_TOUCHED, SHIFTED.format('0 0.2 0" rpy="0 0 1.5708'), MATCHES),
    "a door that swings into its body": ('lower="0"', 'lower="-1"', CLEAR),
    "a door whose axis is turned round": ('axis xyz="0 0 -1"', 'axis xyz="0 0 1"', CLEAR),
    "a heavy inertia": (INERTIA, INERTIA.replace("0.02", "1000").replace("0.012", "1000"), FITS),
    "moments a thousandth": (INERTIA, INERTIA.replace("0.0", "0.0000"), FITS),
}


@pytest.mark.parametrize("name", BREAKS)
def test_each_break_of_a_shape_fails_its_rule(tmp_path: Path, name: str):
    old, new, rule = BREAKS[name]
    found = failed(tmp_path, changed(old, new))
    assert rule in found
    if rule != MATCHES:  # what stands elsewhere may stand in something, too
        assert set(found) == {rule}


LIKENESSES = {
    "a knob that cannot be touched": ('</visual>\n  <collision><origin xyz="0 0.2 0"/>', KNOB),
    "a padded collision": (DOOR_TOUCHED + DOOR_BOX, DOOR_TOUCHED + DOOR_BOX.replace("0.02 0.4 0.36", "0.03 0.41 0.37")),
    "a door that closes by a degree too far": ('lower="0"', 'lower="-0.02"'),
    "a frame without shapes": (
        "</robot>",
        '<link name="tip"/><joint name="t" type="fixed"><parent link="door"/><child link="tip"/></joint></robot>',
    ),
}


@pytest.mark.parametrize("name", LIKENESSES)
def test_what_a_skilled_user_would_accept_passes(tmp_path: Path, name: str):
    assert failed(tmp_path, changed(*LIKENESSES[name])) == {}


@pytest.mark.parametrize("thin", [0.004, 0.02])
def test_a_drawer_goes_through_a_thin_back_but_not_through_an_open_front(tmp_path: Path, thin: float):
    """The back is thinner than the steps that the drawer is looked at in."""
    boards = {"0.2 0.3 0": f"0.4 {thin} 0.3", "0 0.15 0": f"{thin} 0.3 0.3", "0.4 0.15 0": f"{thin} 0.3 0.3"}
    shapes = "".join(f"<collision>{BOX.format(at=at, size=size)}</collision>" for at, size in boards.items())
    drawer = f"<collision>{BOX.format(at='0.2 0.1 0', size='0.3 0.15 0.2')}</collision>"
    text = f"""<robot name="d"><link name="body">{shapes}</link><link name="drawer">{drawer}</link>
    <joint name="slide" type="prismatic"><parent link="body"/><child link="drawer"/><axis xyz="0 -1 0"/>
    <limit lower="{{}}" upper="{{}}" effort="1" velocity="1"/></joint></robot>"""
    assert CLEAR not in failed(tmp_path, text.format(0, 1))
    assert CLEAR in failed(tmp_path, text.format(-1, 0))


TWO = """<robot name="two"><link name="body"><collision>{body}</collision></link>
<link name="left"><collision>{left}</collision></link><link name="right"><collision>{right}</collision></link>
<joint name="l" type="{kind}"><parent link="body"/><child link="left"/>{at_left}
<axis xyz="{axis}"/><limit lower="{low}" upper="{high}" effort="1" velocity="1"/></joint>
<joint name="r" type="prismatic"><parent link="{carrier}"/><child link="right"/><axis xyz="1 0 0"/>{mimic}
<limit lower="{rest}" upper="1" effort="1" velocity="1"/></joint></robot>"""
DRAWERS = {
    "body": BOX.format(at="-0.2 0 0", size="0.01 1 0.3"),
    "left": BOX.format(at="0 -0.25 0", size="0.26 0.4 0.16"),
    "right": BOX.format(at="0 0.25 0", size="0.3 0.4 0.2"),
    "kind": "prismatic",
    "at_left": "",
    "axis": "1 0 0",
    "low": 0,
    "high": 0.3,
    "carrier": "body",
    "mimic": "",
    "rest": 0,
}
SIBLINGS = {
    "two drawers": ({}, False),
    "a drawer that slides through the other": ({"axis": "0 1 0", "high": 0.5}, True),
    "which follows it away in time": (
        {"axis": "0.6 0.8 0", "high": 0.6, "mimic": '<mimic joint="l" multiplier="3" offset="0"/>'},
        False,
    ),
    "which does not follow it": ({"axis": "0.3 0.953939201 0", "high": 0.5}, True),
    "a door that swings through a drawer": (
        {
            "kind": "revolute",
            "at_left": '<origin xyz="0.17 -0.25 0"/>',
            "left": BOX.format(at="0 0.25 0", size="0.02 0.5 0.2"),
            "axis": "0 0 1",
            "high": 1.5,
        },
        True,
    ),
}


@pytest.mark.parametrize("name", SIBLINGS)
def test_parts_that_no_joint_connects_are_clear_of_each_other_too(tmp_path: Path, name: str):
    changes, through = SIBLINGS[name]
    found = failed(tmp_path, TWO.format(**DRAWERS | changes))
    assert ("parts.clear" in found) == through
    if through:
        assert "'left'" in found["parts.clear"] and "'right'" in found["parts.clear"]


def test_boards_drawn_from_both_sides_have_an_inside_and_open_shells_have_none():
    """As the meshes of PartNet-Mobility: each triangle twice, so that nothing winds round anything."""
    box = trimesh.creation.box((0.4, 0.3, 0.02))
    doubled = trimesh.Trimesh(box.vertices, np.concatenate([box.faces, box.faces[:, ::-1]]), process=False)
    board = make_body([(np.eye(4), doubled)], 100)
    shell = make_body([(np.eye(4), trimesh.Trimesh(box.vertices * (1, 1, 10), box.faces[2:], process=False))], 100)
    point, far = np.array([[0.1, 0.1, 0.004]]), np.array([[0.1, 0.1, 1.0]])
    assert not shell.solids
    assert board.depth(point) == pytest.approx(0.006) and board.depth(far) == 0
    assert board.depth_between(far, -far) > 0.005 and board.depth_between(far, far + 1) == 0


PARTNET = sorted((REAL / "partnet_mobility").glob("4*/mobility.urdf"))


@pytest.mark.skipif(not PARTNET, reason="the real objects are not on this machine")
@pytest.mark.parametrize("path", PARTNET, ids=lambda path: path.parent.name)
def test_real_objects_break_no_rule_of_shapes(path: Path):
    subject = find_subject(path)
    rows = judge_files(subject.urdf, subject.mjcf, subject.folder, {}, lambda rule: None)
    assert [row.reason for row in rows if row.rule in (MATCHES, CLEAR, FITS) and row.verdict == "fail"] == []
