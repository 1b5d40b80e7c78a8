"""Checks an asset before it is shipped: one finding for each fault."""

from __future__ import annotations

import io
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
import trimesh

from export.check.rules import MAX_HULLS
from export.check.same_asset import RULES as COPIES
from export.check.same_asset import judge_copy
from export.inertia import find_unphysical
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_asset
from freeart21.files.urdf import (
    LARGEST_LIMIT,
    UrdfJoint,
    UrdfLink,
    UrdfShape,
    link_poses,
    read_file_names,
    read_urdf_joints,
    read_urdf_parts,
)
from freeart21.files.urdf_files import describe_missing_file, resolve_file
from freeart21.mesh import join_meshes
from freeart21.se3 import Array
from freeart21.view.mesh_pieces import read_pieces
from generator.simulate import joint_motion

MAX_MESH_BYTES = 256 << 20
"""Largest mesh or material file that is read."""
Files = Callable[[str], Path]
"""Maps a file name in the URDF to a path."""
Shapes = list[tuple[Array, trimesh.Trimesh]]
"""Pose (4, 4) in the link, and mesh, of each shape."""
UNREADABLE = "numbers and meshes"
"""The rule that numbers and meshes can be read."""
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
    except (FreeArtError, ValueError, OverflowError, RecursionError) as error:
        return [Finding("asset", str(error))]
    findings = check_urdf(asset.urdf, asset.urdf.parent)
    if findings:
        return findings
    try:
        copies = [judge_copy(rule, asset) for rule in COPIES] if "parts" in asset.source else []  # written by `export`
        unlike = [Finding(row.rule, row.reason) for row in copies if row.verdict == "fail"]
        return [*_check_reload(asset), *unlike]
    except Exception as error:  # hostile numbers reach parsers and geometry of many libraries
        return [Finding(UNREADABLE, _first_line(error))]


def check_urdf(urdf: Path, folder: Path) -> list[Finding]:
    """Faults of a URDF and of the files that it names in `folder`, without simulation."""
    try:
        links, joints = read_urdf_parts(urdf)
    except FreeArtError as error:
        return [Finding(UNREADABLE, str(error))]
    masses = [finding for link in links for finding in _check_masses(link, joints)]
    findings = [*_check_tree(links, joints), *_check_names(links, joints), *_check_paths(urdf, folder)]
    if any(f.item == "tree" or f.rule == "paths.exist" for f in findings):  # the rest needs a valid tree and all files
        return [*findings, *masses]
    findings += masses
    files = partial(resolve_file, urdf, root=folder)
    try:
        for link in links:
            shapes = load_shapes(link.collisions, files)
            if not any(finding.broken for finding in masses):
                findings += _check_mass_centre(link, shapes)
            findings += _check_collisions(link, shapes)
            findings += _check_textures(link, files, folder)
        for joint in joints:
            findings += check_limits(joint)
    except Exception as error:  # hostile numbers reach parsers and geometry of many libraries
        findings.append(Finding(UNREADABLE, _first_line(error)))
    return findings


def _first_line(error: Exception) -> str:
    lines = str(error).splitlines() or [""]
    return lines[0] if isinstance(error, FreeArtError) else f"{type(error).__name__}: {lines[0]}"


def _check_tree(links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> Iterator[Finding]:
    names, ends = [link.name for link in links], [(joint.parent, joint.child) for joint in joints]
    for end in {e for pair in ends for e in pair} - set(names):
        yield Finding("tree.links-exist", f"a joint names link '{end}'; links: {', '.join(names)}")
    parents = Counter(child for _, child in ends)
    roots = [name for name in names if name not in parents]
    if len(roots) != 1:
        yield Finding("tree.one-root", f"roots are {', '.join(roots) or 'none'}, expected one")
    connected = set(roots)
    while new := {child for parent, child in ends if parent in connected} - connected:
        connected |= new
    if roots and set(names) - connected:
        unconnected = ", ".join(sorted(set(names) - connected))
        yield Finding("tree.one-root", f"links {unconnected} are not connected to the root")
    for child, count in sorted(parents.items()):
        if count > 1:
            yield Finding("tree.one-parent", f"link '{child}' is the child of {count} joints, expected one")


def _check_names(links: Sequence[UrdfLink], joints: Sequence[UrdfJoint]) -> Iterator[Finding]:
    groups = {
        "link": [link.name for link in links],
        "joint": [joint.name for joint in joints],
        "visual": [shape.name for link in links for shape in link.visuals if shape.name],
        "collision": [shape.name for link in links for shape in link.collisions if shape.name],
    }
    for kind, names in groups.items():
        for name, count in sorted(Counter(names).items()):
            if count > 1 or not name:
                yield Finding("names.unique", f"{kind} name '{name}' is used {count} times, expected unique names")


def _check_paths(urdf: Path, folder: Path) -> Iterator[Finding]:
    for name in read_file_names(urdf, ("mesh", "texture")):
        if not name or Path(name).is_absolute() or "://" in name or " " in name:
            expected = "expected a relative path without spaces in the asset's folder"
            yield Finding("paths.relative", f"file '{name}', {expected}")
        try:
            if not resolve_file(urdf, name, folder).is_file():
                yield Finding("paths.exist", f"file {describe_missing_file(urdf, name, folder)}")
        except FreeArtError as error:
            yield Finding("paths.exist", str(error))


def _check_masses(link: UrdfLink, joints: Sequence[UrdfJoint]) -> Iterator[Finding]:
    """Mass and inertia that no body can have."""
    if link.inertial is None:
        if any(joint.child == link.name and joint.type != "fixed" for joint in joints):
            yield Finding("inertia.present", f"link '{link.name}' moves and has no <inertial>", broken=True)
    elif wrong := find_unphysical(link.inertial):
        yield Finding("inertia.physical", f"link '{link.name}': {wrong}", broken=True)


def _check_mass_centre(link: UrdfLink, shapes: Shapes) -> Iterator[Finding]:
    """A centre of mass outside the link's collision geometry."""
    points = [se3.transform(T, mesh.vertices) for T, mesh in shapes]
    if points and link.inertial is not None:
        box, centre = np.concatenate(points), link.inertial.centre
        if (centre < box.min(0) - 1e-6).any() or (centre > box.max(0) + 1e-6).any():
            yield Finding(
                "inertia.centre-inside", f"link '{link.name}' has its centre of mass outside of its collision box"
            )


def _check_collisions(link: UrdfLink, shapes: Shapes) -> Iterator[Finding]:
    name, n = link.name, len(link.collisions)
    if link.visuals and not n:
        yield Finding("collision.present", f"link '{name}' has a visual but no collision geometry")
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


def _check_textures(link: UrdfLink, files: Files, folder: Path) -> Iterator[Finding]:
    for path in (files(shape.filename) for shape in link.visuals if shape.filename.lower().endswith(".obj")):
        for library in values_after(path, "mtllib"):
            material = checked.inside(folder, str((path.parent / library).resolve()))
            if not material.is_file():
                yield Finding("textures.exist", f"{path.name} names {library}, which does not exist")
                continue
            for image in values_after(material, "map_Kd"):
                if not (material.parent / image).is_file():
                    yield Finding("textures.exist", f"{material.name} names {image}, which does not exist")


def check_limits(joint: UrdfJoint) -> Iterator[Finding]:
    """Faults of a joint's axis and limits."""
    name = f"joint '{joint.name}'"
    if joint.type != "fixed" and abs(joint.axis_length - 1) > 1e-6:
        yield Finding("axis.unit", f"{name} has an axis of length {joint.axis_length:.6g}, expected 1")
    if joint.type not in ("revolute", "prismatic"):
        return
    if not joint.limited:
        yield Finding("limits.present", f"{name} has no <limit>")
        return
    limits = f"{name} has limits {joint.lower:g} to {joint.upper:g}"
    if np.isinf([joint.lower, joint.upper]).any():
        yield Finding("limits.present", f"{limits}, expected within {LARGEST_LIMIT:g} rad or m, or type 'continuous'")
    if not joint.lower < joint.upper:
        yield Finding("limits.ordered", f"{limits}, expected lower < upper")
    elif not joint.lower <= 0 <= joint.upper:
        yield Finding("limits.zero-within", f"{limits}, expected zero within")
    for key, value in (("effort", joint.effort), ("velocity", joint.velocity)):
        if value is not None and not value > 0:
            yield Finding(f"limits.{key}", f"{name} has {key} {value:g}, expected more than 0")
        elif value is None:
            yield Finding(f"limits.{key}", f"{name} has no finite {key}, expected more than 0")


def _check_reload(asset: Asset) -> Iterator[Finding]:
    """Poses of the moving link by the URDF's numbers against SAPIEN."""
    joint = read_urdf_joints(asset.urdf)[asset.joint]
    lower, upper = np.clip([joint.lower, joint.upper], -1e3, 1e3) if joint.limited else (-1.0, 1.0)
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


def _T_reference_moving(asset: Asset, q: float) -> Array:
    """Forward kinematics from the URDF's numbers alone, with other joints held."""
    Ts = link_poses(read_urdf_joints(asset.urdf), {**asset.held, asset.joint: q})
    return se3.inverse(Ts[asset.reference_link]) @ Ts[asset.moving_link]


def load_shapes(shapes: Sequence[UrdfShape], files: Files) -> Shapes:
    """Pose in the link, and scaled mesh, of every visual or collision shape that has a geometry.

    Raises FreeArtError when a mesh cannot be read.
    """
    solids = ((shape.T_link_shape, _load_geometry(shape, files)) for shape in shapes)
    return [(T, solid) for T, solid in solids if solid is not None]


def _load_geometry(shape: UrdfShape, files: Files) -> trimesh.Trimesh | None:
    """The mesh of a geometry in its own frame; None for a kind that URDF does not have."""
    match shape.kind, shape.size.tolist():
        case "box", size:
            return trimesh.creation.box(size)
        case "sphere", [radius]:
            return trimesh.creation.icosphere(3, radius)
        case "cylinder", [radius, length]:
            return trimesh.creation.cylinder(radius, length)
        case "capsule", [radius, length]:
            return trimesh.creation.capsule(length, radius)
        case "mesh", _:
            return read_solid(files(shape.filename)).apply_scale(shape.size)
    return None


def read_solid(path: Path) -> trimesh.Trimesh:
    """The triangles of a mesh file. Equal corners are merged, except in an OBJ, which has shared vertices."""
    if path.suffix.lower() != ".obj":
        mesh = join_meshes([piece.mesh for piece in read_pieces(path, path.parent)])
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
