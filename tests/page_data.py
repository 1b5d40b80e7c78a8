"""What tests of pages share: a small sequence, truth, result and asset, and a reader of the data in pages."""

from __future__ import annotations

import base64
import json
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.articulation import Articulation
from freeart21.asset import Asset
from freeart21.camera import Camera
from freeart21.effects.viscous_damping import ViscousDamping
from freeart21.files.asset import write_asset_json
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Reconstruction
from freeart21.recording import Frame, Recording
from freeart21.truth import Truth
from freeart21.view.link_shapes import of_trimesh

N, WIDTH, HEIGHT = 6, 48, 32
HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>\"'&\u2028"
VOID = {"meta", "link", "img", "br", "input", "hr"}
DTYPES = {"f32": "<f4", "u32": "<u4", "u16": "<u2", "u8": "u1"}


class Parsed(HTMLParser):
    """Elements, attributes and scripts of a page; fails on elements that are not closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.attributes: list[tuple[str, str]] = []
        self.open: list[str] = []
        self.scripts: list[tuple[bool, str]] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]
        if tag not in VOID:
            self.open.append(tag)
        if tag == "script":
            self.scripts.append((dict(attrs).get("type") == "application/json", ""))

    def handle_startendtag(self, tag: str, attrs: list) -> None:
        self.tags.append(tag)
        self.attributes += [(name, value or "") for name, value in attrs]

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "script":
            self.scripts[-1] = (self.scripts[-1][0], self.scripts[-1][1] + data)

    @property
    def data(self) -> list[dict]:
        return [json.loads(text) for is_data, text in self.scripts if is_data]


def extract_array(data: dict[str, Any]) -> NDArray[Any]:
    """The array behind the output of `embed_array` or `embed_points`."""
    array = np.frombuffer(base64.b64decode(data["base64"]), DTYPES[data["dtype"]]).reshape(data["shape"])
    return data["low"] + array * np.asarray(data["steps"]) if "low" in data else array


def box(size: list[float]) -> Mesh:
    return of_trimesh(trimesh.creation.box(size))


def coloured(mesh: Mesh, seed: int) -> Mesh:
    colours = np.random.default_rng(seed).integers(0, 256, (len(mesh.vertices), 3))
    return Mesh(mesh.vertices, mesh.faces, colours.astype(np.uint8))


def make_truth(joint_type: str = "revolute") -> Truth:
    joint = Joint("lid", joint_type, [0.0, 0.6, 0.8], [0.05, -0.02, 0.01], -0.2, 1.1)  # type: ignore[arg-type]
    reference = coloured(box([0.2, 0.1, 0.05]), 1)
    moving = coloured(box([0.1, 0.1, 0.02]).moved(se3.pose(np.eye(3), [0.05, 0, 0.04])), 2)
    states = np.linspace(0.0, 1.0, N) ** 2
    twists = np.random.default_rng(3).normal(0, 0.3, (N, 6))
    reference_poses = se3.pose(np.eye(3), [0, 0, 0.8]) @ se3.exp_se3(twists)
    masks = np.zeros((N, HEIGHT, WIDTH), np.uint8)
    masks[:, 8:24, 8:24], masks[:, 8:24, 24:36] = 1, 2
    flags = (np.ones(len(reference.faces), bool), np.ones(len(moving.faces), bool))
    return Truth(
        Articulation(joint, reference, moving),
        states,
        reference_poses,
        reference_poses @ joint.transform(states),
        np.full((N, 2), 200),
        flags,
        flags,
        lambda i: masks[i],
        lambda i: np.zeros((HEIGHT, WIDTH, 3), np.uint8),
        lambda i: masks[i] > 0,
        {"object": "box", "motion": {"name": "tumble", "seed": 3}},
    )


def perfect_result(truth: Truth, shift: float = 0.3, sign: float = -1.0) -> Reconstruction:
    """The truth in another canonical frame, with the axis turned round (or not) and another state zero."""
    T_new_old = se3.exp_se3([0.3, -0.2, 0.1, 0.4, 1.0, -0.7])
    at_shift = truth.articulation.moving.moved(truth.articulation.joint.transform(shift))
    joint = truth.articulation.joint if sign > 0 else truth.articulation.joint.reversed()
    old = Articulation(joint, truth.articulation.reference, at_shift)
    new = old.moved(T_new_old)
    states = sign * (truth.states - shift)
    reference = truth.Ts_camera_reference @ se3.inverse(T_new_old)
    return Reconstruction(
        new,
        states,
        reference,
        reference @ new.joint.transform(states),
        np.stack([truth.part_mask(i) for i in range(N)]),
        np.array([[True, i not in (2, 3)] for i in range(N)]),
        np.array([0.01, 0.02, np.nan, np.nan, 0.02, 0.01]),
        seconds={"tracks": 2.5, "joint": 0.5},
    )


def make_recording(n: int = N, name: str = "sequence", noise: bool = False) -> Recording:
    rng = np.random.default_rng(0)
    truth = make_truth()

    def load(i: int) -> Frame:
        rgb = rng.integers(0, 256, (HEIGHT, WIDTH, 3)) if noise else np.full((HEIGHT, WIDTH, 3), 20 * (i % N) + 40)
        mask = truth.part_mask(i % N) > 0
        return Frame(rgb.astype(np.uint8), np.where(mask, 0.8, 0.0).astype(np.float32), mask)

    return Recording(Camera.from_fov(WIDTH, HEIGHT, 0.8), np.arange(n) / 10, load, licence="CC-BY-4.0", name=name)


def write_urdf(folder: Path, link: str = "lid", body: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    name = link.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    path = folder / "thing.urdf"
    path.write_text(f"""<?xml version="1.0"?><robot name="thing">
      <link name="base"><visual><geometry><box size="0.2 0.1 0.05"/></geometry>
        <material name="m"><color rgba="1 0 0 1"/></material></visual>
        <inertial><origin rpy="0 0 1.5707963267948966"/><mass value="2.5"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="2" iyz="0" izz="3"/></inertial></link>
      <link name="{name}"><visual><origin xyz="0.05 0 0"/><geometry><cylinder radius="0.02" length="0.1"/></geometry>
        </visual><collision><geometry><sphere radius="0.05"/></geometry></collision></link>
      <joint name="hinge" type="revolute"><origin xyz="0.1 0 0" rpy="0 1.5707963267948966 0"/><parent link="base"/>
        <child link="{name}"/><axis xyz="0 0 2"/><limit lower="-0.5" upper="1.5" effort="3"/>
        <dynamics damping="0.02"/></joint>{body}</robot>""")
    return path


def write_asset(folder: Path) -> Path:
    urdf = write_urdf(folder)
    effects = {"hinge": (ViscousDamping(0.02),)}
    write_asset_json(folder, Asset(urdf, "hinge", "base", "lid", np.eye(4), 0.25, effects, source={"made": "by hand"}))
    return folder
