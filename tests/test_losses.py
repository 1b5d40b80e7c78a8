"""LOSSES.md and the asset's base: what formats and engines keep, checked in the engines."""

from __future__ import annotations

import importlib.util
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from engine_case import EFFECTS, write_case
from test_export import reconstruction

from export import losses
from export.checklist import check_asset
from export.exporter import ExportSettings, export_result
from export.losses import ENGINES, FORMATS, format_losses, outcome
from freeart21.effects import EFFECTS as EVERY
from freeart21.effects.armature import Armature
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.latch import Latch
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from generator.simulate import joint_motion
from leaderboard.asset_measurement import measure_asset
from simgap.prove.writeback import write_repaired

HAS_USD = importlib.util.find_spec("pxr") is not None
ALL = frozenset({"object.urdf", "object.xml", "object.usdc"})


def cells(text: str, row: str) -> list[str]:
    """The cells of every table's row of this name."""
    return [
        cell.strip() for line in text.splitlines() if line.startswith(f"| {row} |") for cell in line.split("|")[2:-1]
    ]


def test_losses_list_only_this_assets_effects(tmp_path: Path):
    asset = write_case(tmp_path, "revolute", (ViscousDamping(0.1), Latch(0.2, 0.1, 0.05, 0.5)))
    text = (tmp_path / "LOSSES.md").read_text()
    assert set(cells(text, "latch")) == {losses.LOST}
    assert (
        losses.LOST not in cells(text, "viscous damping") and "coulomb" not in text.split("\n\n", 3)[3].split("##")[1]
    )
    assert "a base that moves freely" in text and "a base that stands fixed" not in text
    assert text == format_losses(asset, True, ALL if HAS_USD else ALL - {"object.usdc"})
    assert "textures" not in format_losses(asset, False, ALL)
    bare = format_losses(asset, True, ALL - {"object.usdc"})
    assert "There is no USD" in bare and "usd-core 26" not in bare


def test_every_effect_has_an_entry_in_every_column(tmp_path: Path):
    for column in (*FORMATS, *ENGINES):
        assert set(column.outcomes) <= set(losses.SUBJECTS) | set(EVERY), column.name
    for name, kind in EVERY.items():
        urdf, mjcf, _ = (outcome(column, name) for column in FORMATS)
        numbers = [spec.scale if spec.scale >= spec.lower else spec.lower for spec in kind.parameters().values()]
        effect = kind(*numbers)
        assert (urdf == losses.KEPT) == bool(effect.urdf_dynamics()) and (mjcf == losses.KEPT) == bool(
            effect.mjcf_joint()
        )


@pytest.mark.parametrize("base", ["free", "fixed"])
def test_either_base_gives_the_same_asset(tmp_path: Path, base):
    answer = reconstruction(frame=3)
    asset = export_result(answer, tmp_path / "a", ExportSettings(base=base))
    assert asset.reference_link == "reference" and check_asset(tmp_path / "a") == []
    root = ET.parse(asset.urdf).getroot()
    assert next(link.get("name") for link in root.findall("link")) == ("world" if base == "fixed" else "reference")
    angles = np.array([0.0, 0.3, 0.8])
    expected = answer.articulation.joint.transform(angles)
    np.testing.assert_allclose(joint_motion(asset, angles), expected, atol=1e-6)
    measured = measure_asset(tmp_path / "a", angles, whole=False)
    joint, states = measured.joint, measured.states
    np.testing.assert_allclose(joint.transform(states), expected, atol=1e-5)
    free = ET.parse(tmp_path / "a/object.xml").find(".//freejoint")
    assert (free is not None) == (base == "free")


@pytest.mark.parametrize("base", ["free", "fixed"])
def test_mujoco_keeps_and_loses_what_losses_md_says(tmp_path: Path, base):
    import mujoco

    write_case(tmp_path, "revolute", base=base, pivot=np.array([0.02, 0.0, 0.05]))
    of_urdf, of_mjcf = (mujoco.MjModel.from_xml_path(str(tmp_path / f"object.{end}")) for end in ("urdf", "xml"))
    for model in (of_urdf, of_mjcf):
        assert [model.body(i).name for i in range(model.nbody)] == ["world", "reference", "moving"]
        assert model.ngeom == 4 and (model.geom_contype == 0).sum() == 2
    joint = of_urdf.joint("hinge")
    assert (
        joint.damping[0] == EFFECTS["revolute"][0].coefficient and joint.frictionloss[0] == EFFECTS["revolute"][1].level
    )
    assert (of_urdf.nq, of_mjcf.nq) == (1, 8 if base == "free" else 1)  # the URDF's root never moves
    assert (of_urdf.ntex, of_mjcf.ntex) == (0, 2)
    touching = []
    for model in (of_urdf, of_mjcf):
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        touching.append(data.ncon)
    column = next(c for c in ENGINES if c.name.startswith("MuJoCo") and c.reads == "object.urdf")
    assert touching[1] == 0 and (touching[0] == 0) == (outcome(column, "parts") == losses.KEPT)


def test_a_repaired_asset_lists_the_added_effects(tmp_path: Path):
    asset = write_case(tmp_path / "a", "revolute", (ViscousDamping(0.01),))
    again = write_repaired(asset, (CoulombFriction(0.2), Armature(0.003)), tmp_path / "b")
    text = (tmp_path / "b/LOSSES.md").read_text()
    assert cells(text, "coulomb friction") and not cells((tmp_path / "a/LOSSES.md").read_text(), "coulomb friction")
    assert '"friction": 0.2' in (tmp_path / "b/loaders/joint.json").read_text()
    assert (tmp_path / "b/object.usdc").is_file() == HAS_USD
    assert read_asset(tmp_path / "b").effects == again.effects
    bare = write_repaired(read_asset(asset.urdf), (CoulombFriction(0.2),), tmp_path / "c")
    assert (bare.urdf.parent / "LOSSES.md").is_file()
