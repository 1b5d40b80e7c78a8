"""Rules on an exported asset's files against each other: visual meshes, certificate, MJCF and loaders."""

from __future__ import annotations

import importlib.util
import json
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from itertools import islice
from pathlib import Path

import numpy as np

from export.certificate import certify, find_differences, measure_files
from export.check.mjcf_tree import UnsupportedMjcf, count_shapes, read_mjcf_tree
from export.check.report import Row
from export.check.rules import MASS_TOLERANCE, POSE_TOLERANCE, VISUAL_DEPTH_M
from export.check.tree import Tree
from export.checklist import Shapes
from export.loaders import FOLDER, joint_numbers
from export.model import WORLD
from freeart21 import processes, se3
from freeart21.asset import Asset
from freeart21.certificate import Certificate
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.files.asset import read_asset
from freeart21.files.certificate import read_certificate
from freeart21.files.urdf import UrdfInertial, read_urdf

VISUALS, CERTIFIED, MJCF, LOADERS = "parts.visuals-clear", "certificate.same", "mjcf.same", "loaders.same"
RULES = (VISUALS, CERTIFIED, MJCF, LOADERS)
_STATES = 7
"""Joint positions at which poses are compared."""
_MAX_SHOWN = 3
"""Differences that a reason lists."""


def judge_consistency(urdf: Path, mjcf: Path | None, tree: Tree, seen: Mapping[str, Shapes]) -> Iterator[Row]:
    """A row of each of `RULES`, skipped for what `export` did not write.

    Args:
        urdf: the asset's URDF.
        mjcf: its MJCF.
        tree: of the URDF.
        seen: visual shapes by link.
    """
    exported = (urdf.parent / "asset.json").is_file()
    try:
        asset = read_asset(urdf.parent) if exported else None
    except FreeArtError as error:
        yield from (Row(rule, "file", "fail", str(error)) for rule in RULES)
        return
    if asset is None or "parts" not in asset.source:
        yield from (Row(rule, "file", "skip", "it was not written by `export`") for rule in RULES)
        return
    try:
        measured = certify(asset, measure_files(asset.urdf, asset.joint, fidelity=False))
    except Exception as error:  # links that the URDF lacks, or facts of any type
        reason = f"it cannot be measured: {processes.one_line(error)[:300]}"
        yield from (Row(rule, "file", "fail", reason) for rule in (VISUALS, CERTIFIED))
    else:
        depth = measured.visual_overlap_m
        reason = f"visual meshes are {1000 * depth:.3g} mm in each other, expected at most {1000 * VISUAL_DEPTH_M:g}"
        yield Row(VISUALS, "file", "pass" if depth <= VISUAL_DEPTH_M else "fail", reason, depth, "m")
        yield _judge_certificate(asset, measured, seen)
    yield _judge_differences(MJCF, mjcf, lambda file: _compare_mjcf(tree, file, urdf))
    numbers = urdf.parent / FOLDER / "joint.json"
    yield _judge_differences(LOADERS, numbers, lambda file: _compare_numbers(file, asset))


def _judge_differences(rule: str, file: Path | None, compare: Callable[[Path], Iterator[str]]) -> Row:
    """The row of a rule that fails with every difference found in a file; skipped without it."""
    if file is None or not file.is_file():
        return Row(rule, "file", "skip", "there is no such file")
    try:
        found = list(islice(compare(file), _MAX_SHOWN))
    except UnsupportedMjcf as error:
        if importlib.util.find_spec("mujoco") is None:
            return Row(rule, "file", "skip", str(error))
        found = [f"{file.name} was changed: {error}"]
    except FreeArtError as error:
        found = [str(error)]
    return Row(rule, "file", "fail" if found else "pass", "; ".join(found))


def _judge_certificate(asset: Asset, measured: Certificate, seen: Mapping[str, Shapes]) -> Row:
    folder = asset.urdf.parent
    try:
        stated = read_certificate(folder)
    except FreeArtError as error:
        return Row(CERTIFIED, "file", "fail", str(error))
    if stated is None:
        return Row(CERTIFIED, "file", "skip", "there is no certificate.json")
    corners = [se3.transform(T, mesh.vertices) for shapes in seen.values() for T, mesh in shapes]
    found = find_differences(stated, measured, float(np.linalg.norm(np.ptp(np.concatenate(corners), axis=0))))
    return Row(CERTIFIED, "file", "fail" if found else "pass", "; ".join(found[:_MAX_SHOWN]))


def _compare_mjcf(tree: Tree, mjcf: Path, urdf: Path) -> Iterator[str]:
    """What the MJCF has otherwise than the URDF's `tree`. Damping and friction are `engine.*` and effects.json's."""
    other = read_mjcf_tree(mjcf)
    bodies = [link for link in tree.links if link != WORLD]
    if set(bodies) != set(other.links):
        yield f"{mjcf.name} has bodies {', '.join(other.links)}, the URDF {', '.join(bodies)}"
        return
    for name in bodies:
        mine, its = tree.inertials.get(name), other.inertials.get(name)
        if mine is None or its is None or not _same_inertial(mine, its):
            yield f"{mjcf.name} gives '{name}' another mass, centre or inertia than the URDF"
    for joint in tree.movable:
        found = other.joints.get(joint.name)
        if found is None or found.kind != joint.kind:
            yield f"{mjcf.name} has no {joint.kind} joint '{joint.name}'"
            return
        ends = np.array([joint.lower, joint.upper]), np.array([found.lower, found.upper])
        if not np.allclose(*ends, rtol=0, atol=POSE_TOLERANCE):
            yield f"{mjcf.name} limits joint '{joint.name}' to {ends[1]}, the URDF to {ends[0]}"
        for q in np.linspace(*joint.sweep, _STATES):
            Ts, Ts_other = (t.link_poses({joint.name: float(q)}) for t in (tree, other))
            off = np.abs(
                se3.inverse(Ts[joint.parent]) @ Ts[joint.child]
                - se3.inverse(Ts_other[joint.parent]) @ Ts_other[joint.child]
            ).max()
            if off > POSE_TOLERANCE:
                yield f"{mjcf.name} puts '{joint.child}' {off:.2g} from its pose in the URDF at {q:.3g}"
                break
    yield from _compare_shapes(mjcf, urdf)


def _same_inertial(one: UrdfInertial, other: UrdfInertial) -> bool:
    return all(
        bool(np.abs(np.asarray(a) - b).max() <= MASS_TOLERANCE * max(np.abs(a).max(), 1e-12))
        for a, b in ((one.mass, other.mass), (one.inertia, other.inertia))
    ) and bool(np.abs(one.centre - other.centre).max() <= POSE_TOLERANCE)


def _compare_shapes(mjcf: Path, urdf: Path) -> Iterator[str]:
    """Bodies whose geoms use other mesh files, or another number of primitives of a kind, than the URDF's link."""
    geoms = count_shapes(mjcf)
    for name, link in read_urdf(urdf).links.items():
        shapes = [*link.visuals, *link.collisions]
        mine = Counter(shape.filename if shape.kind == "mesh" else shape.kind for shape in shapes)
        if name != WORLD and mine != geoms.get(name):
            differ = ", ".join(sorted((mine - geoms.get(name, Counter())) | (geoms.get(name, Counter()) - mine)))
            yield f"{mjcf.name} has other shapes of '{name}' than the URDF: {differ}"


def _compare_numbers(file: Path, asset: Asset) -> Iterator[str]:
    """Entries of the loaders' joint.json that are not the asset's."""
    stated, right = checked.read_json(file), json.loads(atomic.json_text(joint_numbers(asset)))
    for key in sorted({*stated, *right}):
        if stated.get(key) != right.get(key):
            texts = [checked.shorten(numbers.get(key)) for numbers in (stated, right)]
            yield f"{file.name} has {key} {texts[0]}, the asset {texts[1]}"
