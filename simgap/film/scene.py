"""The asset as two rigid parts with colours, and where they were in every frame of the video."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.asset import read_asset
from freeart21.files.result import read_result
from freeart21.files.truth import read_truth
from freeart21.files.urdf import link_poses, links_beyond, read_urdf
from freeart21.mesh import Mesh, bounding_diagonal
from freeart21.reconstruction import Failure
from freeart21.se3 import Array
from freeart21.view.link_shapes import ShownUrdf, read_shown
from freeart21.view.obj import PLAIN


@dataclass(frozen=True)
class Skin:
    """One rigid part, in the canonical frame at state zero, with what it looks like."""

    vertices: Array
    """(V, 3) metres."""
    faces: NDArray[np.int64]
    """(F, 3)."""
    colours: Array
    """(V, 3) sRGB, 0 to 255."""
    uv: Array
    """(V, 2); zero where there is no texture."""
    texture: NDArray[np.int64]
    """(F,) index into `textures`, -1 for none."""
    textures: tuple[NDArray[np.uint8], ...]
    """(h, w, 3) RGB each."""

    @property
    def mesh(self) -> Mesh:
        """The bare triangles."""
        return Mesh(self.vertices, self.faces)


@dataclass(frozen=True)
class Placed:
    """Where both parts were."""

    Ts: tuple[Array, Array]
    """(n, 4, 4) camera from canonical, reference and moving part."""
    seen: NDArray[np.bool_]
    """(n,) whether both poses of a frame are known."""
    exact: bool
    """Whether the poses are the truth of a recording; else they were estimated from the same video."""
    source: str
    """Where the poses come from, in words."""


@dataclass(frozen=True)
class FilmScene:
    """All that the simulated film needs."""

    parts: tuple[Skin, Skin]
    """Reference and moving part."""
    placed: Placed
    coloured: bool
    """Whether the asset says anything of its colours."""
    same_video: bool
    """Whether the asset was reconstructed from the video itself: then its size and shape have taken on the camera's."""

    @property
    def diagonal(self) -> float:
        """Of the object at state zero, metres."""
        return bounding_diagonal(*(part.mesh for part in self.parts))


def read_scene(asset_path: Path, sequence: Path, poses: Path | None = None, root: Path | None = None) -> FilmScene:
    """The asset in a folder (or URDF), with the part poses of a result or of a recording's truth.

    Without `poses` they are looked for in the result that holds the asset's folder, then in the data folder that holds
    the sequence. Raises FreeArtError when there are none, or they are not of this asset.
    """
    found = _found(Path(asset_path), Path(sequence)) if poses is None else Path(poses)
    if (found / "truth.json").is_file():
        return _of_truth(Path(asset_path), found, root)
    if (found / "prediction.json").is_file():
        return _of_result(read_asset(asset_path, guesses=False, root=root), found)
    raise FreeArtError(f"{found} holds no part poses: expected a result (prediction.json) or a truth (truth.json)")


def _found(asset: Path, sequence: Path) -> Path:
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
    T = _canonical_root(asset, q) if described else np.eye(4)
    placed = Placed(
        (truth.Ts_camera_reference, truth.Ts_camera_moving), np.ones(len(truth), bool), True, "the recording's truth"
    )
    return _scene(asset, q, T, reference, placed, same_video=False)


def _of_result(asset: Asset, folder: Path) -> FilmScene:
    result = read_result(folder, appearance=False)
    if isinstance(result, Failure):
        raise FreeArtError(f"{folder} has no part poses: the method gave up at {result.stage}")
    q = {**asset.held, asset.joint: asset.state_zero}
    T = _canonical_root(asset, q)
    joint = result.articulation.joint
    _check_same_joint(asset, q, T, joint.axis, folder)
    shrink = np.eye(4)
    shrink[:3, :3] /= asset.scale
    placed = Placed(
        (result.Ts_camera_reference, result.Ts_camera_moving),
        np.asarray(result.seen.all(1)),
        False,
        "the reconstruction of this video",
    )
    return _scene(asset, q, shrink @ T, _side(asset), placed, same_video=True)


def _canonical_root(asset: Asset, q: dict[str, float]) -> Array:
    Ts = link_poses(read_urdf(asset.urdf).joints, q)
    return np.asarray(asset.T_canonical_reference @ se3.inverse(Ts.get(asset.reference_link, np.eye(4))))


def _check_same_joint(asset: Asset, q: dict[str, float], T_canonical_root: Array, axis: Array, folder: Path) -> None:
    """The asset's axis must be the result's: else the poses mean another frame."""
    urdf = read_urdf(asset.urdf)
    joint = urdf.joints[asset.joint]
    Ts = link_poses(urdf.joints, q)
    own = T_canonical_root[:3, :3] @ Ts.get(joint.child, np.eye(4))[:3, :3] @ joint.axis
    off = np.degrees(np.arccos(np.clip(abs(own @ axis), 0, 1)))
    if off > 5:
        raise FreeArtError(
            f"{folder} has poses of another frame than {asset.urdf}: their joint axes are {off:.0f} degrees apart, "
            "expected the result that the asset was exported from"
        )


def _side(asset: Asset) -> set[str]:
    """Links on the reference link's side of the scored joint."""
    urdf = read_urdf(asset.urdf)
    below = links_beyond(urdf.joints, urdf.joints[asset.joint].child)
    return below if asset.reference_link in below else set(urdf.links) - below


def _scene(
    asset: Asset, q: dict[str, float], T_canonical_root: Array, reference: set[str], placed: Placed, same_video: bool
) -> FilmScene:
    shown = read_shown(asset.urdf, asset.root)
    if shown.missing:
        raise FreeArtError(f"{asset.urdf} names the mesh {shown.missing[0]}, which is missing")
    Ts = shown.urdf.link_poses(q)
    placing = {name: T_canonical_root @ T for name, T in Ts.items()}
    sides = [name for name in shown.visuals if name in reference], [n for n in shown.visuals if n not in reference]
    parts = _skin(shown, placing, sides[0]), _skin(shown, placing, sides[1])
    for name, part in zip(("reference", "moving"), parts, strict=True):
        if not len(part.faces):
            raise FreeArtError(f"{asset.urdf} has no visual mesh on its {name} side, expected one to film")
    coloured = any(len(p.textures) or bool((p.colours != np.array(PLAIN)).any()) for p in parts)
    return FilmScene(parts, placed, coloured, same_video)


def _skin(shown: ShownUrdf, placing: dict[str, Array], links: list[str]) -> Skin:
    vertices, faces, colours, uv, texture = [], [], [], [], []
    pictures: dict[Path, int] = {}
    count = 0
    for name in links:
        for piece in shown.visuals[name]:
            mesh, index = piece.mesh, -1
            if mesh.empty:
                continue
            if piece.texture is not None and piece.uv is not None:
                index = pictures.setdefault(piece.texture, len(pictures))
            vertices.append(mesh.vertices @ placing[name][:3, :3].T + placing[name][:3, 3])
            faces.append(mesh.faces + count)
            plain = np.tile(np.array(PLAIN, np.uint8), (len(mesh.vertices), 1))
            colours.append(plain if mesh.colours is None else mesh.colours)
            uv.append(np.zeros((len(mesh.vertices), 2)) if index < 0 or piece.uv is None else piece.uv)
            texture.append(np.full(len(mesh.faces), index))
            count += len(mesh.vertices)
    if not vertices:
        return Skin(np.zeros((0, 3)), np.zeros((0, 3), int), np.zeros((0, 3)), np.zeros((0, 2)), np.zeros(0, int), ())
    textures = tuple(checked.read_rgb(path) for path in pictures)
    return Skin(
        np.concatenate(vertices),
        np.concatenate(faces),
        np.concatenate(colours).astype(float),
        np.concatenate(uv),
        np.concatenate(texture),
        textures,
    )
