"""Checks an asset before it is shipped: one finding for each fault."""

from __future__ import annotations

import importlib.util
import io
import xml.etree.ElementTree as ET
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from export.check.rules import MAX_HULLS
from export.inertia import find_unphysical
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_asset
from freeart21.files.urdf import (
    LARGEST_LIMIT,
    UrdfInertial,
    link_poses,
    parse_numbers,
    parse_origin,
    parse_urdf,
    read_attribute,
    read_urdf_joints,
)
from freeart21.files.urdf_files import describe_missing_file, resolve_file
from freeart21.se3 import Array
from freeart21.view.mesh_pieces import read_pieces
from freeart21.view.simplify import joined
from generator.simulate import joint_motion

MAX_MESH_BYTES = 256 << 20
"""Largest mesh or material file that is read."""
Files = Callable[[str], Path]
"""Maps a file name in the URDF to a path."""
Shapes = list[tuple[Array, trimesh.Trimesh]]
"""Pose (4, 4) in the link, and mesh, of each shape."""
FK_TOLERANCE = 1e-6
"""Rotation entries and metres by which two simulators may differ in a link's pose within a metre (`allowed_off`)."""


def allowed_off(*poses: Array) -> float:
    """By how much two simulators may differ in poses (..., 4, 4): `FK_TOLERANCE`, or that share of the largest
    coordinate beyond a metre. Engines compute in single precision, whose steps grow with the lengths: a cabinet of 2 m,
    turned 3 m from the camera, was 1.1e-6 off."""
    return FK_TOLERANCE * max(1.0, *(float(np.abs(T).max()) for T in poses))


@dataclass(frozen=True)
class Finding:
    """One fault of an asset."""

    rule: str
    """The rule that it breaks, such as 'limits.zero-within'."""
    detail: str
    """What is wrong, got and expected."""
    broken: bool = False
    """Whether no body can have these numbers (mass or inertia), rather than unlikely ones."""

    @property
    def item(self) -> str:
        """Group of the rule, such as 'limits'."""
        return self.rule.partition(".")[0]

    def __str__(self) -> str:
        return f"{self.item}: {self.detail}"


def check_asset(folder: Path) -> list[Finding]:
    """All faults of the asset in `folder`; empty when it may be shipped.

    Reads the URDF as text and every file that it names, reloads it in SAPIEN (and its MJCF in MuJoCo when installed),
    and compares the moving link's poses. A folder that is no asset gives one finding.
    """
    folder = Path(folder)
    try:
        asset = read_asset(folder)
        robot = parse_urdf(asset.urdf)
    except (FreeArtError, ValueError, OverflowError, RecursionError) as error:
        return [Finding("asset", str(error))]
    findings = check_urdf(robot, asset.urdf, asset.urdf.parent)
    if findings:
        return findings
    try:
        return list(_check_reload(asset, robot))
    except Exception as error:  # hostile numbers reach parsers and geometry of many libraries
        return [Finding("numbers and meshes", _first_line(error))]


def check_urdf(robot: ET.Element, urdf: Path, folder: Path) -> list[Finding]:
    """Faults of the URDF's text and of the files that it names in `folder`, without simulation."""
    masses = [finding for link in robot.findall("link") for finding in _check_masses(link, robot)]
    findings = [*_check_tree(robot), *_check_names(robot), *_check_paths(robot, urdf, folder)]
    if any(f.item == "tree" or f.rule == "paths.exist" for f in findings):  # the rest needs a valid tree and all files
        return [*findings, *masses]
    findings += masses
    files = partial(resolve_file, urdf, root=folder)
    try:
        for link in robot.findall("link"):
            shapes = load_shapes(link, "collision", files)
            if not any(finding.broken for finding in masses):
                findings += _check_mass_centre(link, shapes)
            findings += _check_collisions(link, shapes)
            findings += _check_textures(link, files, folder)
        for joint in robot.findall("joint"):
            findings += [*_check_axis(joint), *_check_limits(joint)]
    except Exception as error:  # hostile numbers reach parsers and geometry of many libraries
        findings.append(Finding("numbers and meshes", _first_line(error)))
    return findings


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines() or [""]
    return lines[0] if isinstance(error, FreeArtError) else f"{type(error).__name__}: {lines[0]}"


def _check_tree(robot: ET.Element) -> Iterator[Finding]:
    links = [link.get("name", "") for link in robot.findall("link")]
    ends = [(read_attribute(j, "parent", "link"), read_attribute(j, "child", "link")) for j in robot.findall("joint")]
    for end in {e for pair in ends for e in pair}:
        if end not in links:
            yield Finding("tree.links-exist", f"a joint names link '{end}'; links: {', '.join(links)}")
    children = [child for _, child in ends]
    roots = [link for link in links if link not in children]
    if len(roots) != 1:
        yield Finding("tree.one-root", f"roots are {', '.join(roots) or 'none'}, expected one")
    connected = set(roots)
    while new := {child for parent, child in ends if parent in connected} - connected:
        connected |= new
    if roots and set(links) - connected:
        unconnected = ", ".join(sorted(set(links) - connected))
        yield Finding("tree.one-root", f"links {unconnected} are not connected to the root")
    for child in sorted({c for c in children if children.count(c) > 1}):
        yield Finding("tree.one-parent", f"link '{child}' is the child of {children.count(child)} joints, expected one")


def _check_names(robot: ET.Element) -> Iterator[Finding]:
    groups = {
        "link": robot.findall("link"),
        "joint": robot.findall("joint"),
        "visual": list(robot.iter("visual")),
        "collision": list(robot.iter("collision")),
    }
    for kind, elements in groups.items():
        names = [e.get("name", "") for e in elements if kind in ("link", "joint") or e.get("name")]
        for name in sorted({n for n in names if names.count(n) > 1 or not n}):
            yield Finding(
                "names.unique", f"{kind} name '{name}' is used {names.count(name)} times, expected unique names"
            )


def _check_paths(robot: ET.Element, urdf: Path, folder: Path) -> Iterator[Finding]:
    for element in [*robot.iter("mesh"), *robot.iter("texture")]:
        name = element.get("filename", "")
        if not name or Path(name).is_absolute() or "://" in name or " " in name:
            expected = "expected a relative path without spaces in the asset's folder"
            yield Finding("paths.relative", f"file '{name}', {expected}")
        try:
            if not resolve_file(urdf, name, folder).is_file():
                yield Finding("paths.exist", f"file {describe_missing_file(urdf, name, folder)}")
        except FreeArtError as error:
            yield Finding("paths.exist", str(error))


def _check_masses(link: ET.Element, robot: ET.Element) -> Iterator[Finding]:
    """Mass and inertia that no body can have."""
    name = link.get("name")
    if link.find("inertial") is None:
        if any(read_attribute(j, "child", "link") == name for j in robot.findall("joint") if j.get("type") != "fixed"):
            yield Finding("inertia.present", f"link '{name}' moves and has no <inertial>", broken=True)
        return
    rows = ("ixx ixy ixz", "ixy iyy iyz", "ixz iyz izz")
    try:
        inertia = np.array([[_read_number(link, "inertial/inertia", key, "0") for key in row.split()] for row in rows])
        wrong = find_unphysical(
            UrdfInertial(_read_number(link, "inertial/mass", "value", "0"), _read_mass_centre(link), inertia)
        )
    except (FreeArtError, np.linalg.LinAlgError) as error:
        wrong = f"mass, centre or inertia cannot be read: {error}"
    if wrong:
        yield Finding("inertia.physical", f"link '{name}': {wrong}", broken=True)


def _check_mass_centre(link: ET.Element, shapes: Shapes) -> Iterator[Finding]:
    """A centre of mass outside the link's collision geometry."""
    points = [se3.transform(T, mesh.vertices) for T, mesh in shapes]
    if points and link.find("inertial") is not None:
        box, centre = np.concatenate(points), _read_mass_centre(link)
        if (centre < box.min(0) - 1e-6).any() or (centre > box.max(0) + 1e-6).any():
            yield Finding(
                "inertia.centre-inside",
                f"link '{link.get('name')}' has its centre of mass outside of its collision box",
            )


def _read_mass_centre(link: ET.Element) -> Array:
    return parse_numbers(
        read_attribute(link, "inertial/origin", "xyz", "0 0 0"), 3, f"link '{link.get('name')}' has xyz"
    )


def _check_collisions(link: ET.Element, shapes: Shapes) -> Iterator[Finding]:
    name = link.get("name")
    if link.find("visual") is not None and link.find("collision") is None:
        yield Finding("collision.present", f"link '{name}' has a visual but no collision geometry")
    n = len(link.findall("collision"))
    if n > MAX_HULLS:
        yield Finding("collision.few", f"link '{name}' has {n} collision geometries, expected at most {MAX_HULLS}")
    for k, (_, mesh) in enumerate(shapes):
        convex = mesh.convex_hull.volume if len(mesh.faces) else 0.0
        if not mesh.is_watertight or not mesh.volume > 0:
            yield Finding(
                "collision.closed", f"mesh {k} of link '{name}' is not a closed solid with its faces outwards"
            )
        elif mesh.volume < convex * (1 - 1e-3):
            filled = f"it fills {mesh.volume / convex:.1%} of its hull"
            yield Finding("collision.convex", f"mesh {k} of link '{name}' is not convex: {filled}")


def _check_textures(link: ET.Element, files: Files, folder: Path) -> Iterator[Finding]:
    for mesh in link.findall("visual/geometry/mesh"):
        path = files(mesh.get("filename", ""))
        if path.suffix.lower() != ".obj":
            continue
        for library in values_after(path, "mtllib"):
            material = checked.inside(folder, str((path.parent / library).resolve()))
            if not material.is_file():
                yield Finding("textures.exist", f"{path.name} names {library}, which does not exist")
                continue
            for image in values_after(material, "map_Kd"):
                if not (material.parent / image).is_file():
                    yield Finding("textures.exist", f"{material.name} names {image}, which does not exist")


def _check_axis(joint: ET.Element) -> Iterator[Finding]:
    if joint.get("type") == "fixed":
        return
    name = joint.get("name")
    length = float(
        np.linalg.norm(parse_numbers(read_attribute(joint, "axis", "xyz", "1 0 0"), 3, f"joint '{name}' has axis"))
    )
    if abs(length - 1) > 1e-6:
        yield Finding("axis.unit", f"joint '{name}' has an axis of length {length:.6g}, expected 1")


def _check_limits(joint: ET.Element) -> Iterator[Finding]:
    name = joint.get("name")
    if joint.get("type") not in ("revolute", "prismatic"):
        return
    if joint.find("limit") is None:
        yield Finding("limits.present", f"joint '{name}' has no <limit>")
        return
    lower, upper = (_read_number(joint, "limit", key, "0", finite=False) for key in ("lower", "upper"))
    if max(abs(lower), abs(upper)) > LARGEST_LIMIT:
        limits = f"joint '{name}' has limits {lower:g} to {upper:g}"
        yield Finding("limits.present", f"{limits}, expected within {LARGEST_LIMIT:g} rad or m, or type 'continuous'")
    if not lower < upper:
        yield Finding("limits.ordered", f"joint '{name}' has limits {lower:g} to {upper:g}, expected lower < upper")
    elif not lower <= 0 <= upper:
        yield Finding("limits.zero-within", f"joint '{name}' has limits {lower:g} to {upper:g}, expected zero within")
    for key in ("effort", "velocity"):
        value = _read_number(joint, "limit", key, "0", finite=False)
        if not value > 0:
            yield Finding(f"limits.{key}", f"joint '{name}' has {key} {value:g}, expected more than 0")


def _check_reload(asset: Asset, robot: ET.Element) -> Iterator[Finding]:
    """Poses of the moving link by the URDF's numbers against SAPIEN and MuJoCo."""
    joint = next(j for j in robot.findall("joint") if j.get("name") == asset.joint)
    lower, upper = (_read_number(joint, "limit", key, default) for key, default in (("lower", "-1"), ("upper", "1")))
    positions = np.linspace(lower, upper, 7)
    poses = np.stack([_T_reference_moving(asset, q) for q in positions])
    zero = _T_reference_moving(asset, asset.state_zero)
    C = asset.T_canonical_reference
    expected = C @ poses @ se3.inverse(zero) @ se3.inverse(C)
    try:
        plain = replace(asset, effects={})  # kinematic effects are beyond URDF
        off = float(np.abs(joint_motion(plain, positions - asset.state_zero) - expected).max())
    except FreeArtError as fault:
        yield Finding("reload", str(fault))
        return
    if off > allowed_off(C, poses, expected):
        yield Finding("reload", f"SAPIEN moves '{asset.moving_link}' to {off:.2g} from its pose in the URDF")
    mjcf = asset.urdf.with_suffix(".xml")
    if mjcf.is_file() and importlib.util.find_spec("mujoco"):
        yield from _check_mujoco(asset, mjcf, positions, poses)


def _check_mujoco(asset: Asset, mjcf: Path, positions: Array, poses: Array) -> Iterator[Finding]:
    import mujoco

    try:
        model = mujoco.MjModel.from_xml_path(str(mjcf))
    except ValueError as error:
        yield Finding("mujoco", str(error).splitlines()[0])
        return
    data = mujoco.MjData(model)

    def pose(body: str) -> Array:
        return se3.pose(data.body(body).xmat.reshape(3, 3), data.body(body).xpos)

    worst = 0.0
    for q, T in zip(positions, poses, strict=True):
        data.joint(asset.joint).qpos[0] = q
        mujoco.mj_kinematics(model, data)
        off = np.abs(se3.inverse(pose(asset.reference_link)) @ pose(asset.moving_link) - T).max()
        worst = max(worst, float(off))
    if worst > allowed_off(poses):
        yield Finding("mujoco", f"MuJoCo puts '{asset.moving_link}' {worst:.2g} from its pose in the URDF")


def _T_reference_moving(asset: Asset, q: float) -> Array:
    """Forward kinematics from the URDF's numbers alone, with other joints held."""
    Ts = link_poses(read_urdf_joints(asset.urdf), {**asset.held, asset.joint: q})
    return se3.inverse(Ts[asset.reference_link]) @ Ts[asset.moving_link]


def load_shapes(link: ET.Element, tag: str, files: Files) -> Shapes:
    """Pose in the link, and scaled mesh, of every visual or collision element (`tag`) of a link that has a geometry.

    Raises FreeArtError when a mesh cannot be read or a size is invalid.
    """
    found = []
    where = f"link '{link.get('name')}'"
    for element in link.findall(tag):
        shape = element.find("geometry/*")
        solid = None if shape is None else _load_geometry(shape, files, where)
        if solid is not None:
            found.append((parse_origin(element, where), solid))
    return found


def _load_geometry(shape: ET.Element, files: Files, where: str) -> trimesh.Trimesh | None:
    """The mesh of a geometry in its own frame; None for a kind that URDF does not have."""

    def size(attribute: str, count: int = 1, default: str | None = None) -> Array:
        return parse_numbers(shape.get(attribute, default), count, f"{where} has {attribute}")

    match shape.tag:
        case "box":
            return trimesh.creation.box(size("size", 3))
        case "sphere":
            return trimesh.creation.icosphere(3, float(size("radius")[0]))
        case "cylinder":
            return trimesh.creation.cylinder(float(size("radius")[0]), float(size("length")[0]))
        case "capsule":
            return trimesh.creation.capsule(float(size("length")[0]), float(size("radius")[0]))
        case "mesh":
            path = files(shape.get("filename", ""))
            loaded = read_solid(path)
            return loaded.apply_scale(size("scale", 3, "1 1 1"))
    return None


def read_solid(path: Path) -> trimesh.Trimesh:
    """The triangles of a mesh file. Equal corners are merged, except in an OBJ, which has shared vertices."""
    if path.suffix.lower() != ".obj":
        mesh = joined(*(piece.mesh for piece in read_pieces(path, path.parent)))
        solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
        solid.merge_vertices(merge_tex=True, merge_norm=True)
        return solid
    data = io.BytesIO(checked.read_bytes(path, MAX_MESH_BYTES, checked.ANYWHERE))
    try:
        return trimesh.load_mesh(data, file_type="obj", process=False, skip_materials=True)
    except Exception as error:
        raise FreeArtError(f"{path} is not a readable mesh: {error}") from error


def values_after(path: Path, key: str) -> list[str]:
    """The rest of each line of an OBJ or MTL file that begins with `key`."""
    lines = checked.read_text(path, MAX_MESH_BYTES, errors="replace").split("\n")
    return [line[len(key) :].strip() for line in lines if line.startswith(key + " ")]


def _read_number(element: ET.Element, path: str, attribute: str, default: str, finite: bool = True) -> float:
    what = f"{element.tag} '{element.get('name')}' has {attribute}"
    return float(parse_numbers(read_attribute(element, path, attribute, default), 1, what, finite)[0])
