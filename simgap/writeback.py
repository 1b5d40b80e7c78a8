"""Named effects into a copy of the asset: URDF says what it can, effects.json says all, MJCF says what it can."""

from __future__ import annotations

import dataclasses
import os
import shutil
import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from export.mjcf import joint_words
from export.mjcf_of_urdf import mjcf_of_urdf
from freeart21.asset import Asset
from freeart21.effects.backlash import Backlash
from freeart21.effects.base import Effect
from freeart21.effects.return_spring import ReturnSpring
from freeart21.errors import FreeArtError
from freeart21.files import atomic
from freeart21.files.asset import read_asset, write_asset_json
from generator import simulate

_ONE_SIZE = ("viscous_damping", "coulomb_friction", "quadratic_drag", "load_friction", "armature")
"""Effects of one number that is a size: two of them are one with the sum."""
_POSE_TOLERANCE = 1e-6  # single precision of the engine, metres and rotation entries
_NAMED_FILES = ("mesh", "texture")
_BESIDE_MESH = ("mtllib", "map_Kd", "map_Ka", "map_Bump", "map_bump", "bump")


def repaired(asset: Asset, effects: tuple[Effect, ...], folder: Path, source: dict[str, Any] | None = None) -> Asset:
    """Write a copy of the asset with `effects` added to its joint's into `folder`, reload it, and give it back.

    Args:
        asset: stays as it is.
        effects: what is missing; those of one size add to what the asset has already.
        folder: takes the files; need not exist, must hold nothing else.
        source: what asset.json shall say of where the repair came from.

    Raises FreeArtError when the joint cannot have an effect, a named file is missing or lies where it cannot be copied,
    or the reloaded asset is not the same but for its effects.
    """
    joined = {**asset.effects, asset.joint: joined_effects(asset.effects.get(asset.joint, ()), effects)}
    _copy(asset.urdf, folder)
    urdf = folder / asset.urdf.name
    mjcf = asset.urdf.with_suffix(".xml")
    atomic.write_bytes(urdf, urdf_with_effects(asset.urdf.read_bytes(), joined, asset.urdf))
    if mjcf.is_file():
        atomic.write_bytes(folder / mjcf.name, mjcf_with_effects(mjcf.read_bytes(), asset.joint, joined, mjcf))
    told = {**asset.source, **({"repair": source} if source else {})}
    written = replace(asset, urdf=urdf, effects=joined, source=told)
    if not mjcf.is_file():
        atomic.write_bytes(folder / mjcf.name, mjcf_of_urdf(written))
    write_asset_json(folder, written)
    return _reloaded(asset, joined, folder)


def joined_effects(had: tuple[Effect, ...], new: tuple[Effect, ...]) -> tuple[Effect, ...]:
    """The effects of both, those of one size, and springs, as one; FreeArtError when both have a backlash."""
    out = list(had)
    for effect in new:
        same = next((i for i, e in enumerate(out) if e.name == effect.name), None)
        if same is not None and effect.name in _ONE_SIZE:
            (field,) = effect.parameters()
            out[same] = dataclasses.replace(effect, **{field: getattr(out[same], field) + getattr(effect, field)})  # type: ignore[type-var]
        elif same is not None and isinstance(effect, ReturnSpring):
            out[same] = _one_spring(out[same], effect)
        elif same is not None and isinstance(effect, Backlash):
            raise FreeArtError("the asset's joint has an effect 'backlash' already, expected at most one")
        else:
            out.append(effect)
    return tuple(out)


def _one_spring(a: Effect, b: Effect) -> ReturnSpring:
    """Two springs side by side, which MJCF can say only as one."""
    assert isinstance(a, ReturnSpring) and isinstance(b, ReturnSpring)
    stiffness = a.stiffness + b.stiffness
    rest = (a.stiffness * a.rest + b.stiffness * b.rest) / stiffness if stiffness else a.rest
    return ReturnSpring(stiffness, rest)


def urdf_with_effects(text: bytes, effects: dict[str, tuple[Effect, ...]], where: Path) -> bytes:
    """The URDF with `<dynamics>` of every joint as its effects say; everything else, comments too, stays."""
    root = _parsed(text, where)
    for joint in root.findall("joint"):
        acting = effects.get(joint.get("name", ""), ())
        said = [effect.urdf_dynamics() for effect in acting]
        sums = {word: float(np.sum([s.get(word, 0.0) for s in said])) for word in ("damping", "friction")}
        element = joint.find("dynamics")
        if element is None and not any(sums.values()):
            continue
        element = ET.SubElement(joint, "dynamics") if element is None else element
        for word, value in sums.items():
            element.set(word, repr(value))
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def mjcf_with_effects(text: bytes, joint: str, effects: dict[str, tuple[Effect, ...]], where: Path) -> bytes:
    """The MJCF with the words of its joint as the effects say; FreeArtError when it has no such joint."""
    root = _parsed(text, where)
    element = next((e for e in root.iter("joint") if e.get("name") == joint), None)
    if element is None:
        names = ", ".join(e.get("name", "") for e in root.iter("joint"))
        raise FreeArtError(f"{where} has no joint '{joint}'; joints: {names or 'none'}")
    for word in ("damping", "frictionloss", "armature", "stiffness", "springref"):
        element.attrib.pop(word, None)
    for word, said in joint_words(effects.get(joint, ()), joint).items():
        element.set(word, said)
    return ET.tostring(root, encoding="utf-8") + b"\n"


def _parsed(text: bytes, where: Path) -> ET.Element:
    try:
        return ET.fromstring(text, ET.XMLParser(target=ET.TreeBuilder(insert_comments=True)))
    except ET.ParseError as error:
        raise FreeArtError(f"{where} is not XML: {error}") from error


def _copy(urdf: Path, folder: Path) -> None:
    """The files that an asset needs: its folder when asset.json says that it is one, else what the URDF names."""
    home = urdf.parent
    if (home / "asset.json").is_file():
        shutil.copytree(home, folder, dirs_exist_ok=True, ignore=shutil.ignore_patterns("effects.json"))
        return
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copyfile(urdf, folder / urdf.name)
    for extra in ("semantics.txt", urdf.with_suffix(".xml").name):
        if (home / extra).is_file():
            shutil.copyfile(home / extra, folder / extra)
    for name in _named_files(urdf):
        source, target = home / name, folder / name
        if Path(name).is_absolute() or "://" in name or ".." in Path(name).parts:
            raise FreeArtError(f"{urdf} names file '{name}', expected a path within its folder: it cannot be copied")
        if not source.is_file():
            raise FreeArtError(f"{urdf} names file '{name}', which does not exist")
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, target)


def _named_files(urdf: Path) -> list[str]:
    """Files that a URDF, and the MJCF beside it, name, with the materials and pictures of OBJ meshes."""
    names: list[str] = []
    for path, attribute in ((urdf, "filename"), (urdf.with_suffix(".xml"), "file")):
        if path.is_file():
            root = _parsed(path.read_bytes(), path)
            names += [e.get(attribute, "") for tag in _NAMED_FILES for e in root.iter(tag) if e.get(attribute)]
    for name in list(names):
        if name.lower().endswith(".obj") and (urdf.parent / name).is_file():
            names += _beside(urdf.parent, name)
    return list(dict.fromkeys(names))


def _beside(home: Path, name: str) -> list[str]:
    """What an OBJ or MTL file names, if it is there."""
    found: list[str] = []
    with (home / name).open(encoding="utf-8", errors="replace") as file:
        for line in file:
            word, _, rest = line.strip().partition(" ")
            if word in _BESIDE_MESH and rest:
                other = os.path.normpath(Path(name).parent / rest.split()[-1])
                if (home / other).is_file() and other not in found:
                    found.append(other)
                    found += _beside(home, other) if word == "mtllib" else []
    return found


def _reloaded(asset: Asset, effects: dict[str, tuple[Effect, ...]], folder: Path) -> Asset:
    """The asset as read from `folder`, checked: effects as given, and the joint where it was."""
    read = read_asset(folder)
    if read.effects != {name: said for name, said in effects.items() if said}:
        raise FreeArtError(f"{folder} has effects {read.effects} once reloaded, expected {effects}")
    states = np.array([-0.3, 0.0, 0.4])
    plain = (replace(a, effects={}) for a in (asset, read))
    before, after = (simulate.joint_motion(a, states) for a in plain)
    off = float(np.abs(before - after).max())
    if off > _POSE_TOLERANCE:
        raise FreeArtError(f"{folder} moves its joint {off:.2g} from where the asset did, expected the same")
    return read
