"""The asset as triangles of two rigid parts with colours, and their poses in every frame of the video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.files.result import read_result
from freeart21.files.truth import read_truth
from freeart21.files.urdf import Urdf, read_urdf, subtree_links
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.reconstruction import Failure
from freeart21.se3 import Array
from freeart21.view.link_shapes import read_shown
from freeart21.view.mesh_pieces import PLAIN


@dataclass(frozen=True)
class PartPoses:
    """Poses of both parts."""

    Ts: tuple[Array, Array]
    """(n, 4, 4) camera from canonical, reference and moving part."""
    seen: NDArray[np.bool_]
    """(n,) whether both poses of a frame are known."""
    exact: bool
    """Whether the poses are a recording's truth; else they were estimated from the same video."""
    source: str
    """Source of the poses, in words."""


@dataclass(frozen=True)
class FilmScene:
    """Everything that the simulated film needs."""

    vertices: Array
    """(V, 3) metres, in the canonical frame at state zero."""
    part: NDArray[np.int64]
    """(V,) 1 for the reference part, 2 for the moving one."""
    colours: Array
    """(V, 3) sRGB, 0 to 255."""
    uv: Array
    """(V, 2); zero where there is no texture."""
    faces: NDArray[np.int64]
    """(F, 3), those of the reference part first."""
    texture: NDArray[np.int64]
    """(F,) index into `textures`, -1 for none."""
    textures: tuple[NDArray[np.uint8], ...]
    """(h, w, 3) RGB each."""
    placed: PartPoses

    @property
    def coloured(self) -> bool:
        """Whether the asset has colours."""
        return bool(self.textures) or bool((self.colours != np.array(PLAIN)).any())

    @property
    def diagonal(self) -> float:
        """Of the object at state zero, metres."""
        return bounding_diagonal(Mesh(self.vertices, self.faces))


def read_scene(asset_path: Path, sequence: Path, poses: Path | None = None, root: Path | None = None) -> FilmScene:
    """The asset in a folder (or URDF), with the part poses of a result or of a recording's truth.

    Without `poses` they are searched in the result that contains the asset's folder, then in the data folder that
    contains the sequence. Raises FreeArtError when there are none, or they are of another asset.
    """
    found = _find_poses(Path(asset_path), Path(sequence)) if poses is None else Path(poses)
    if (found / "truth.json").is_file():
        return _of_truth(Path(asset_path), found, root)
    if (found / "prediction.json").is_file():
        return _of_result(read_asset(asset_path, guesses=False, root=root), found)
    raise FreeArtError(f"{found} holds no part poses: expected a result (prediction.json) or a truth (truth.json)")


def _find_poses(asset: Path, sequence: Path) -> Path:
    folder = (asset if asset.is_dir() else asset.parent).resolve()
    if (folder.parent / "prediction.json").is_file():
        return folder.parent
    truth = sequence.resolve().parent.parent / "truth" / sequence.resolve().name
    if (truth / "truth.json").is_file():
        return truth
    raise FreeArtError(
        f"nothing says where {asset} was in {sequence}: expected a result around the asset's folder or a truth beside "
        "the sequence; name either by --poses"
    )


def _of_truth(path: Path, folder: Path, root: Path | None) -> FilmScene:
    truth = read_truth(folder)
    described = path.is_dir() and (path / "asset.json").is_file()
    asset = read_asset(path, None if described else str(truth.source.get("joint")), guesses=False, root=root)
    reference = {str(name) for name in truth.source.get("reference_links") or ()}
    urdf = read_urdf(asset.urdf)
    if not reference or not reference <= set(urdf.links):
        raise FreeArtError(
            f"{folder} is the truth of another object: its reference part is {', '.join(sorted(reference)) or 'untold'}"
            f", {asset.urdf} has the links {', '.join(urdf.links)}"
        )
    held = {str(k): float(v) for k, v in (truth.source.get("held") or {}).items()}
    q = {**held, str(truth.source.get("joint", asset.joint)): asset.state_zero if described else 0.0}
    T = _canonical_root(asset, urdf, q) if described else np.eye(4)
    Ts = truth.Ts_camera_reference, truth.Ts_camera_moving
    return _scene(asset, q, T, reference, PartPoses(Ts, np.ones(len(truth), bool), True, "the recording's truth"))


def _of_result(asset: Asset, folder: Path) -> FilmScene:
    result = read_result(folder, appearance=False)
    if isinstance(result, Failure):
        raise FreeArtError(f"{folder} has no part poses: the method gave up at {result.stage}")
    urdf, q = read_urdf(asset.urdf), {**asset.held, asset.joint: asset.state_zero}
    T = _canonical_root(asset, urdf, q)
    _check_same_joint(asset, urdf, q, T, result.articulation.joint.axis, folder)
    below = subtree_links(urdf.joints, urdf.joints[asset.joint].child)
    reference = below if asset.reference_link in below else set(urdf.links) - below
    shrink = np.eye(4)
    shrink[:3, :3] /= asset.scale
    Ts, seen = (result.Ts_camera_reference, result.Ts_camera_moving), np.asarray(result.seen.all(1))
    placed = PartPoses(Ts, seen, False, "the reconstruction of this video")
    return _scene(asset, q, shrink @ T, reference, placed)


def _canonical_root(asset: Asset, urdf: Urdf, q: dict[str, float]) -> Array:
    return np.asarray(asset.T_canonical_reference @ se3.inverse(urdf.link_poses(q)[asset.reference_link]))


def _check_same_joint(
    asset: Asset, urdf: Urdf, q: dict[str, float], T_canonical_root: Array, axis: Array, folder: Path
) -> None:
    """FreeArtError unless the asset's axis is the result's; else the poses are in another frame."""
    joint = urdf.joints[asset.joint]
    own = T_canonical_root[:3, :3] @ urdf.link_poses(q)[joint.child][:3, :3] @ joint.axis
    off = np.degrees(np.arccos(np.clip(abs(own @ axis), 0, 1)))
    if off > 5:
        raise FreeArtError(
            f"{folder} has poses of another frame than {asset.urdf}: their joint axes are {off:.0f} degrees apart, "
            "expected the result that the asset was exported from"
        )


def _scene(
    asset: Asset, q: dict[str, float], T_canonical_root: Array, reference: set[str], placed: PartPoses
) -> FilmScene:
    shown = read_shown(asset.urdf, asset.root)
    if shown.missing:
        raise FreeArtError(f"{asset.urdf} names the mesh {shown.missing[0]}, which is missing")
    Ts, pictures, at = shown.urdf.link_poses(q), dict[int, NDArray[np.uint8]](), 0
    found: list[tuple[NDArray[Any], ...]] = []
    for name in sorted(shown.visuals, key=lambda name: name not in reference):
        for piece in (p for p in shown.visuals[name] if not p.mesh.empty):
            mesh, index, n = piece.mesh.moved(T_canonical_root @ Ts[name]), -1, len(piece.mesh.vertices)
            if piece.picture is not None:
                pictures[id(piece.picture)] = piece.picture
                index = list(pictures).index(id(piece.picture))
            colours = np.tile(np.array(PLAIN, np.uint8), (n, 1)) if mesh.colours is None else mesh.colours
            uv = np.zeros((n, 2)) if index < 0 or piece.uv is None else piece.uv
            part = np.full(n, 1 if name in reference else 2)
            found.append(
                (mesh.vertices, part, colours.astype(float), uv, mesh.faces + at, np.full(len(mesh.faces), index))
            )
            at += n
    for k, name in ((1, "reference"), (2, "moving")):
        if not any(part[0] == k for _, part, *_ in found):
            raise FreeArtError(f"{asset.urdf} has no visual mesh on its {name} side, expected one to film")
    vertices, parts, rgb, uvs, faces, texture = (np.concatenate(each) for each in zip(*found, strict=True))
    return FilmScene(vertices, parts, rgb, uvs, faces, texture, tuple(pictures.values()), placed)
