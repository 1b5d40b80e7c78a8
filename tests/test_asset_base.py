"""The asset's base, free or fixed, and what MuJoCo keeps of its files."""

from __future__ import annotations

import importlib.util
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
from engine_case import EFFECTS, write_case
from test_export import reconstruction

from export.checklist import check_asset
from export.exporter import export_result
from export.settings import ExportSettings
from freeart21.effects.armature import Armature
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import read_asset
from generator.simulate import joint_motion
from leaderboard.asset_measurement import measure_asset
from simgap.prove.writeback import write_repaired

HAS_USD = importlib.util.find_spec("pxr") is not None


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
def test_mujoco_reads_the_mjcf_whole_and_the_urdf_with_losses(tmp_path: Path, base):
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
    assert touching[0] > 0 and touching[1] == 0  # a part that stands in the world touches the other


def test_a_repaired_asset_has_the_added_effects_in_all_its_files(tmp_path: Path):
    asset = write_case(tmp_path / "a", "revolute", (ViscousDamping(0.01),))
    again = write_repaired(asset, (CoulombFriction(0.2), Armature(0.003)), tmp_path / "b")
    assert '"friction": 0.2' in (tmp_path / "b/loaders/joint.json").read_text()
    assert (tmp_path / "b/object.usdc").is_file() == HAS_USD
    assert read_asset(tmp_path / "b").effects == again.effects
    bare = write_repaired(read_asset(asset.urdf), (CoulombFriction(0.2),), tmp_path / "c")
    assert (bare.urdf.parent / "loaders/joint.json").is_file()
