"""What an asset is made of for physics: collision shapes, mass, and guessed dynamics."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import trimesh

from export.inertia import Inertial
from export.mjcf import mjcf_text
from export.model import AssetModel, LinkModel
from export.primitives import Box, Cylinder, Sphere
from export.urdf import urdf_text
from freeart21 import se3
from freeart21.files.urdf import read_urdf
from freeart21.joint import Joint


def turned_pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return se3.exp_se3(np.concatenate([0.1 * rng.normal(size=3), rng.normal(size=3)]))


SHAPES = (
    Box(np.array([0.1, 0.2, 0.3]), turned_pose(0)),
    Cylinder(0.05, 0.4, turned_pose(1)),
    Sphere(0.07, turned_pose(2)),
)


def test_primitives_stand_in_urdf_and_mjcf_where_the_model_has_them(tmp_path: Path):
    mujoco = pytest.importorskip("mujoco")
    ball = trimesh.creation.icosphere(1, 0.1)
    ball.export(tmp_path / "ball.obj")
    body = Inertial(1.0, np.zeros(3), 0.01 * np.eye(3))
    reference = LinkModel("reference", "ball.obj", None, ("ball.obj",), body, SHAPES)
    moving = LinkModel("moving", "ball.obj", None, (), body, SHAPES[:1])
    joint = Joint("hinge", "revolute", np.array([0, 0, 1.0]), np.zeros(3), -1.0, 1.0)
    model = AssetModel("object", reference, moving, joint, 1.0, 1.0)
    (tmp_path / "a.urdf").write_bytes(urdf_text(model))
    (tmp_path / "a.xml").write_bytes(mjcf_text(model))
    read = read_urdf(tmp_path / "a.urdf").links["reference"].collisions
    loaded = mujoco.MjModel.from_xml_path(str(tmp_path / "a.xml"))
    data = mujoco.MjData(loaded)
    mujoco.mj_forward(loaded, data)
    assert [shape.kind for shape in read] == ["mesh", "box", "cylinder", "sphere"]
    for k, shape in enumerate(SHAPES, 1):
        np.testing.assert_allclose(read[k].T_link_shape, shape.T_link_shape, atol=1e-12)
        geom = data.geom(f"reference_collision_{k:02d}")
        np.testing.assert_allclose(geom.xpos, shape.T_link_shape[:3, 3], atol=1e-12)
        np.testing.assert_allclose(geom.xmat.reshape(3, 3), shape.T_link_shape[:3, :3], atol=1e-12)
    half = loaded.geom("reference_collision_01").size
    np.testing.assert_allclose([*half, *read[1].size], [0.05, 0.1, 0.15, 0.1, 0.2, 0.3])
    np.testing.assert_allclose(loaded.geom("reference_collision_02").size[:2], [0.05, 0.2])
    names = [e.get("name") for e in ET.parse(tmp_path / "a.urdf").iter("collision")]
    assert len(set(names)) == len(names) == 5
