"""The asset as USD: read back with usd-core, it is the URDF's numbers."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh
from engine_case import write_case

from export import usd
from export.check.file_rules import judge_files
from export.usd import write_usd
from freeart21.effects.armature import Armature
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.errors import FreeArtError
from freeart21.files.urdf import read_urdf

KINDS = ("revolute", "prismatic")
EFFECTS = (ViscousDamping(0.02), CoulombFriction(0.3), ReturnSpring(0.5, 0.2), Armature(0.003))


needs_usd = pytest.mark.skipif(
    importlib.util.find_spec("pxr") is None, reason="usd-core is not installed: freeart21[usd]"
)


def opened(folder: Path):
    from pxr import Usd

    return Usd.Stage.Open(str(folder / "object.usdc"))


@needs_usd
@pytest.mark.parametrize("kind", KINDS)
def test_the_joints_numbers_are_in_the_units_of_usd(tmp_path: Path, kind):
    asset = write_case(tmp_path, kind, EFFECTS)
    stage = opened(tmp_path)
    joint = read_urdf(asset.urdf).joints["hinge"]
    prim = stage.GetPrimAtPath("/bob/hinge")
    axis, degree = ("angular", np.pi / 180) if kind == "revolute" else ("linear", 1.0)
    attributes = {a.GetName(): a.Get() for a in prim.GetAttributes()}
    expected = {
        "physics:lowerLimit": joint.lower / degree,
        "physics:upperLimit": joint.upper / degree,
        f"drive:{axis}:physics:damping": 0.02 * degree,
        f"drive:{axis}:physics:stiffness": 0.5 * degree,
        f"drive:{axis}:physics:targetPosition": 0.2 / degree,
        f"drive:{axis}:physics:maxForce": joint.effort,
        f"physxJointAxis:{axis}:staticFrictionEffort": 0.3,
        f"physxJointAxis:{axis}:dynamicFrictionEffort": 0.3,
        f"physxJointAxis:{axis}:armature": 0.003,
        f"physxJointAxis:{axis}:maxJointVelocity": joint.velocity / degree,
        "newton:friction": 0.3,
        "newton:armature": 0.003,
        "newton:velocityLimit": joint.velocity / degree,
    }
    assert {name: attributes[name] for name in expected} == pytest.approx(expected, rel=1e-6)
    assert {f"PhysicsDriveAPI:{axis}", f"PhysxJointAxisAPI:{axis}"} <= set(
        prim.GetPrimTypeInfo().GetAppliedAPISchemas()
    )


@needs_usd
def test_meshes_wear_their_pictures_and_hulls_are_hidden_and_convex(tmp_path: Path):
    from pxr import UsdGeom, UsdPhysics, UsdShade

    write_case(tmp_path, "revolute")
    stage = opened(tmp_path)
    for name in ("reference", "moving"):
        seen = trimesh.load_mesh(tmp_path / f"meshes/{name}.obj", process=False)
        prim = stage.GetPrimAtPath(f"/bob/{name}/visual_00")
        mesh = UsdGeom.Mesh(prim)
        np.testing.assert_allclose(mesh.GetPointsAttr().Get(), seen.vertices, atol=1e-7)
        np.testing.assert_array_equal(np.reshape(mesh.GetFaceVertexIndicesAttr().Get(), (-1, 3)), seen.faces)
        np.testing.assert_allclose(UsdGeom.PrimvarsAPI(prim).GetPrimvar("st").Get(), seen.visual.uv, atol=1e-6)
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        picture = UsdShade.Shader(stage.GetPrimAtPath(material.GetPath().AppendChild("picture")))
        assert Path(picture.GetInput("file").Get().resolvedPath) == (tmp_path / f"meshes/{name}.png").resolve()
        hull = stage.GetPrimAtPath(f"/bob/{name}/collision_00")
        assert UsdGeom.Imageable(hull).GetPurposeAttr().Get() == "guide" and hull.HasAPI(UsdPhysics.CollisionAPI)
        assert UsdPhysics.MeshCollisionAPI(hull).GetApproximationAttr().Get() == "convexHull"


def test_without_usd_core_one_line_says_what_to_install(tmp_path: Path, monkeypatch):
    asset = write_case(tmp_path, "revolute")
    monkeypatch.setattr(usd, "is_available", lambda: False)
    with pytest.raises(FreeArtError, match=r"usd-core is not installed, .*pip install 'freeart21\[usd\]'"):
        write_usd(tmp_path / "b.usdc", asset)
    assert not (tmp_path / "b.usdc").exists()


def _set(prim: str, name: str, value: object) -> Callable:
    return lambda stage: stage.GetPrimAtPath(f"/bob/{prim}").GetAttribute(name).Set(value)


def _turn_inertia(stage) -> None:
    from pxr import Gf

    turned = Gf.Quatf(float(np.sqrt(0.5)), float(np.sqrt(0.5)), 0.0, 0.0)
    stage.GetPrimAtPath("/bob/moving").GetAttribute("physics:principalAxes").Set(turned)


EDITS: dict[str, tuple[Callable, str]] = {
    "rad where USD counts degrees": (_set("hinge", "physics:upperLimit", 2.5), "limits joint 'hinge'"),
    "axis": (_set("hinge", "physics:axis", "Y"), "puts 'moving'"),
    "pivot": (_set("hinge", "physics:localPos0", (0.15, 0.02, 0.11)), "puts 'moving'"),
    "mass": (_set("moving", "physics:mass", 500.0), "gives 'moving' another mass"),
    "inertia": (_turn_inertia, "gives 'moving' another mass, centre or inertia"),
    "place": (_set("moving", "xformOp:translate", (0.0, 0.0, 0.0)), "puts 'moving'"),
    "sides": (
        lambda stage: stage.GetPrimAtPath("/bob/hinge").GetRelationship("physics:body1").SetTargets(["/bob/reference"]),
        "has joint 'hinge' between 'reference' and 'reference'",
    ),
    "units": (lambda stage: stage.SetMetadata("metersPerUnit", 0.01), "counts in 0.01 m"),
    "no joint": (lambda stage: stage.RemovePrim("/bob/hinge"), "has no revolute joint 'hinge'"),
    "another layer": (
        lambda stage: stage.GetRootLayer().subLayerPaths.append("/etc/passwd"),
        "names /etc/passwd",
    ),
}


def said_of_usd(folder: Path) -> tuple[str, str]:
    """Verdict and reason of check-asset's rule."""
    rows = judge_files(folder / "object.urdf", folder / "object.xml", folder, {}, lambda rule: None)
    (row,) = (row for row in rows if row.rule == "usd.same")
    return row.verdict, row.reason


@needs_usd
@pytest.mark.parametrize("base", ["free", "fixed"])
@pytest.mark.parametrize("kind", KINDS)
def test_a_layer_read_back_says_what_the_urdf_says(tmp_path: Path, kind, base):
    write_case(tmp_path, kind, EFFECTS, base)
    assert said_of_usd(tmp_path) == ("pass", "")


@needs_usd
@pytest.mark.parametrize("edit", EDITS)
def test_a_layer_that_says_another_thing_fails(tmp_path: Path, edit):
    write_case(tmp_path, "revolute")
    stage = opened(tmp_path)
    change, message = EDITS[edit]
    change(stage)
    stage.GetRootLayer().Save()
    verdict, reason = said_of_usd(tmp_path)
    assert verdict == "fail" and message in reason
