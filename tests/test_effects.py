"""Effects: bounds and units hold, every file round-trips, and what contradicts itself is refused."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from freeart21.effects import EFFECTS, effect_from_json, effects_from_urdf_dynamics
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset, read_effects, write_asset_json

EXAMPLES = (ViscousDamping(0.3), CoulombFriction(0.2), ReturnSpring(4.0, -0.1))
TYPES = pytest.mark.parametrize("kind", ["revolute", "prismatic"])


def write_urdf(folder: Path, inside: str = "", kind: str = "revolute") -> Path:
    path = folder / "lid.urdf"
    path.write_text(f"""<robot name="lid"><link name="a"/><link name="b"/><joint name="j" type="{kind}">
        <parent link="a"/><child link="b"/><limit lower="0" upper="1"/>{inside}</joint></robot>""")
    return path


def test_every_effect_of_the_library_has_an_example():
    assert {type(e) for e in EXAMPLES} == set(EFFECTS.values())
    assert all(EFFECTS[cls.name] is cls for cls in EFFECTS.values())


@TYPES
@pytest.mark.parametrize("effect", EXAMPLES, ids=lambda e: e.name)
def test_round_trip_through_json_text(effect, kind):
    data = json.loads(json.dumps(effect.to_json(kind)))
    assert effect_from_json(data, kind, "here") == effect
    for name, spec in effect.parameters().items():
        assert data["parameters"][name]["unit"] == spec.unit(kind)


@pytest.mark.parametrize("cls", EFFECTS.values(), ids=lambda c: c.name)
def test_bounds_are_closed_and_a_hair_beyond_is_refused(cls):
    specs = cls.parameters()
    for bound in ("lower", "upper"):
        good = {name: getattr(spec, bound) for name, spec in specs.items()}
        assert cls(**good) == cls(**good)
        for name, spec in specs.items():
            beyond = np.nextafter(getattr(spec, bound), -np.inf if bound == "lower" else np.inf)
            for value in (beyond, np.nan, np.inf, "1", None):
                with pytest.raises(FreeArtError, match=f"effect '{cls.name}' {name} is"):
                    cls(**{**good, name: value})


@TYPES
def test_wrong_unit_missing_and_unknown_parameters_are_refused(kind):
    data = ViscousDamping(0.3).to_json(kind)
    other = "prismatic" if kind == "revolute" else "revolute"
    with pytest.raises(FreeArtError, match=r"here: effect 'viscous_damping' coefficient has unit '.*', expected"):
        effect_from_json(data, other, "here")
    for parameters in ({}, {**data["parameters"], "extra": {"value": 1, "unit": "s"}}, None):
        with pytest.raises(FreeArtError, match=r"expected \['coefficient'\]"):
            effect_from_json({**data, "parameters": parameters}, kind, "here")


def test_unknown_effect_lists_the_known_ones():
    for data in ({"effect": "magic"}, {}, "magic", None):
        with pytest.raises(FreeArtError, match="effects: coulomb_friction, return_spring, viscous_damping"):
            effect_from_json(data, "revolute", "here")


def test_forces_and_limits_are_what_their_formulas_say():
    damping, friction, spring = EXAMPLES
    assert damping.force(0.7, -2.0, 0.0) == 0.6
    assert spring.force(0.4, 9.0, 0.0) == pytest.approx(-2.0)
    assert (friction.force(0.7, 3.0, 0.0), friction.drive_limit(0.7, 3.0)) == (0.0, 0.2)
    assert [e.acts for e in EXAMPLES] == ["force", "drive", "force"]


def test_words_of_urdf_and_mjcf():
    assert [e.urdf_dynamics() for e in EXAMPLES] == [{"damping": 0.3}, {"friction": 0.2}, {}]
    assert [e.mjcf_joint() for e in EXAMPLES] == [
        {"damping": 0.3},
        {"frictionloss": 0.2},
        {"stiffness": 4.0, "springref": -0.1},
    ]
    assert effects_from_urdf_dynamics(0.3, 0.2) == EXAMPLES[:2]
    assert effects_from_urdf_dynamics(0.0, 0.0) == ()


def described(folder: Path, inside: str = '<dynamics damping="0.3" friction="0.2"/>') -> None:
    asset = read_asset(write_urdf(folder, inside))
    write_asset_json(folder, replace(asset, effects={"j": EXAMPLES}))


def test_effects_json_round_trips_beside_its_urdf(tmp_path: Path):
    described(tmp_path)
    assert read_asset(tmp_path).effects == {"j": EXAMPLES}


def test_effects_json_of_another_urdf_is_refused(tmp_path: Path):
    described(tmp_path)
    urdf = tmp_path / "lid.urdf"
    urdf.write_text(urdf.read_text() + "\n")
    with pytest.raises(FreeArtError, match="written for another lid.urdf"):
        read_asset(tmp_path)


@pytest.mark.parametrize(
    "inside, said",
    [
        ("", r"damping 0.3, but lid.urdf says 0"),
        ('<dynamics damping="0.3"/>', r"friction 0.2, but lid.urdf says 0"),
        ('<dynamics damping="0.31" friction="0.2"/>', r"damping 0.3, but lid.urdf says 0.31"),
    ],
)
def test_effects_json_that_contradicts_the_urdf_is_refused(tmp_path: Path, inside: str, said: str):
    described(tmp_path, inside)
    with pytest.raises(FreeArtError, match=said):
        read_asset(tmp_path)


def test_effects_json_of_unknown_joint_or_shape_is_refused(tmp_path: Path):
    described(tmp_path)
    path = tmp_path / "effects.json"
    data = json.loads(path.read_text())
    for joints, said in (
        ({"lid": []}, "joint 'lid', which is not a movable joint of the URDF; movable joints: j"),
        ({"j": {}}, "must map joint names to lists"),
        ([], "must map joint names to lists"),
        ({"j": ["spring"]}, "unknown effect"),
    ):
        path.write_text(json.dumps({**data, "joints": joints}))
        with pytest.raises(FreeArtError, match=said):
            read_asset(tmp_path)


def test_without_effects_json_the_urdf_speaks(tmp_path: Path):
    assert read_effects(write_urdf(tmp_path)) == {}
    assert read_effects(write_urdf(tmp_path, '<dynamics damping="0.3"/>')) == {"j": EXAMPLES[:1]}
    with pytest.raises(FreeArtError, match="damping 'much', expected a finite number"):
        read_effects(write_urdf(tmp_path, '<dynamics damping="much"/>'))
    with pytest.raises(FreeArtError, match="viscous_damping"):
        read_effects(write_urdf(tmp_path, '<dynamics damping="-1"/>'))
