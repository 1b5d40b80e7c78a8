"""An asset's MJCF, USD layer and loaders against its URDF: bodies, masses, joints, limits, poses and shapes."""

from __future__ import annotations

import importlib.util
import json
from collections import Counter
from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path

import numpy as np

from export.check.mjcf_tree import UnsupportedMjcf, count_shapes, read_mjcf_tree
from export.check.report import Row
from export.check.rules import MASS_TOLERANCE, POSE_TOLERANCE
from export.check.tree import Tree, build_tree
from export.loaders import FOLDER, joint_numbers
from export.model import WORLD
from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.urdf import UrdfInertial, read_urdf

MJCF, USD, LOADERS = RULES = ("mjcf.same", "usd.same", "loaders.same")
_STATES = 7
"""Joint positions at which poses are compared."""
_MAX_SHOWN = 3
"""Differences that a reason lists."""


def judge_copy(rule: str, asset: Asset) -> Row:
    """The row of one of `RULES`, which fails with what a file has otherwise; skipped without the file or its reader."""
    places: dict[str, tuple[Path, str, Callable[[Path, Asset], Iterator[str]]]] = {
        MJCF: (asset.urdf.with_suffix(".xml"), "mujoco", _compare_mjcf),
        USD: (asset.urdf.with_suffix(".usdc"), "pxr", _compare_usd),
        LOADERS: (asset.urdf.parent / FOLDER / "joint.json", "json", _compare_numbers),
    }
    file, reader, compare = places[rule]
    if not file.exists():
        return Row(rule, "file", "skip", "there is no such file")
    if importlib.util.find_spec(reader) is None:
        return Row(rule, "file", "skip", f"{file.name} was not read: {reader} is not installed")
    try:
        found = list(islice(compare(file, asset), _MAX_SHOWN))
    except (UnsupportedMjcf, FreeArtError) as error:
        found = [f"{file.name} is not as `export` writes it: {error}"]
    return Row(rule, "file", "fail" if found else "pass", "; ".join(found))


def _compare_mjcf(mjcf: Path, asset: Asset) -> Iterator[str]:
    """Differences in the tree, and bodies whose geoms use other mesh files, or another number of primitives of a kind.
    Damping and friction are `engine.*` and effects.json's."""
    urdf = read_urdf(asset.urdf)
    yield from _compare_trees(mjcf.name, build_tree(urdf), read_mjcf_tree(mjcf))
    geoms = count_shapes(mjcf)
    for name, link in urdf.links.items():
        shapes = [*link.visuals, *link.collisions]
        mine = Counter(shape.filename if shape.kind == "mesh" else shape.kind for shape in shapes)
        if name != WORLD and mine != geoms.get(name):
            differ = ", ".join(sorted((mine - geoms.get(name, Counter())) | (geoms.get(name, Counter()) - mine)))
            yield f"{mjcf.name} has other shapes of '{name}' than the URDF: {differ}"


def _compare_usd(layer: Path, asset: Asset) -> Iterator[str]:
    """Differences in the tree, and bodies that stand elsewhere in the layer."""
    from export.check.usd_tree import read_usd_tree  # needs usd-core

    urdf = read_urdf(asset.urdf)
    other, placed = read_usd_tree(layer, urdf)
    yield from _compare_trees(layer.name, build_tree(urdf), other)
    for name, T in urdf.link_poses(asset.held).items():
        if name in placed and not _same_pose(placed[name], T):
            yield f"{layer.name} puts '{name}' {np.abs(placed[name] - T).max():.2g} from its pose in the URDF"


def _compare_numbers(file: Path, asset: Asset) -> Iterator[str]:
    """Entries of the loaders' joint.json that are not the asset's."""
    stated, right = checked.read_json(file), json.loads(atomic.json_text(joint_numbers(asset)))
    for key in sorted({*stated, *right}):
        if stated.get(key) != right.get(key):
            texts = [checked.shorten(numbers.get(key)) for numbers in (stated, right)]
            yield f"{file.name} has {key} {texts[0]}, the asset {texts[1]}"


def _compare_trees(file: str, tree: Tree, other: Tree) -> Iterator[str]:
    """What the `other` tree, read from `file`, has otherwise than the URDF's."""
    bodies, found = (sorted({*each.links} - {WORLD}) for each in (tree, other))
    if bodies != found:
        yield f"{file} has bodies {', '.join(found)}, the URDF {', '.join(bodies)}"
        return
    for name in bodies:
        mine, its = tree.inertials.get(name), other.inertials.get(name)
        if mine is not None and (its is None or not _same_inertial(mine, its)):
            yield f"{file} gives '{name}' another mass, centre or inertia than the URDF"
    mine_moving, its_moving = ({n: j for n, j in each.joints.items() if j.joint_type} for each in (tree, other))
    if unknown := sorted(its_moving.keys() - mine_moving.keys()):
        yield f"{file} has another joint '{unknown[0]}'"
        return
    for name, joint in mine_moving.items():
        same = its_moving.get(name)
        if same is None or same.joint_type != joint.joint_type:
            yield f"{file} has no {joint.joint_type} joint '{name}'"
            return
        if (same.parent, same.child) != (joint.parent, joint.child):
            yield f"{file} has joint '{name}' between '{same.parent}' and '{same.child}'"
            return
        ends = np.array([joint.lower, joint.upper]), np.array([same.lower, same.upper])
        if not np.allclose(*ends, rtol=POSE_TOLERANCE, atol=POSE_TOLERANCE):
            yield f"{file} limits joint '{name}' to {ends[1]}, the URDF to {ends[0]}"
    states = [(name, float(q)) for name, joint in mine_moving.items() for q in np.linspace(*joint.sweep, _STATES)]
    for name, q in states or [("", 0.0)]:
        Ts, Ts_other = (each.link_poses({name: q}) for each in (tree, other))
        for body in bodies:
            T = se3.inverse(Ts[other.root]) @ Ts[body]
            if not _same_pose(T, Ts_other[body]):
                off = np.abs(T - Ts_other[body]).max()
                yield f"{file} puts '{body}' {off:.2g} from its pose in the URDF, with '{name}' at {q:.3g}"
                return


def _same_pose(T: np.ndarray, other: np.ndarray) -> bool:
    """Whether two poses (4, 4) agree; single precision, in which USD keeps them, grows with the lengths."""
    return bool(np.abs(T - other).max() <= POSE_TOLERANCE * max(1.0, float(np.abs(T).max())))


def _same_inertial(one: UrdfInertial, other: UrdfInertial) -> bool:
    return all(
        bool(np.abs(np.asarray(a) - b).max() <= MASS_TOLERANCE * max(np.abs(a).max(), 1e-12))
        for a, b in ((one.mass, other.mass), (one.inertia, other.inertia))
    ) and bool(np.abs(one.centre - other.centre).max() <= POSE_TOLERANCE)
