"""From poses of two parts over keyframes to a whole answer on disk: joint, surfaces, masks, views and an asset."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from baselines.rigid import interpolate_poses
from baselines.surfaces import Labels, draw, fuse, label_frame
from baselines.video import UnsolvableError, Video, read_video
from freeart21 import se3
from freeart21.articulation import PARTS, Articulation
from freeart21.asset import Asset
from freeart21.files import atomic
from freeart21.files.asset import write_asset_json
from freeart21.files.result import write_result
from freeart21.files.sequence import read_sequence
from freeart21.joint_fit import LEAST_POSES, fit_joint, fit_joint_of_type, paper_joint_type
from freeart21.mesh import Mesh, bounding_diagonal, join_meshes
from freeart21.reconstruction import Failure, Reconstruction
from freeart21.recording import Recording
from freeart21.se3 import Array, Bools

DENSITY = 500.0
"""kg/m^3, of the box around a part: a guess, so that the asset can be loaded; a video does not show mass."""


@dataclass(frozen=True)
class Motion:
    """What a baseline finds: the parts' motion and pixels."""

    Ts: Array
    """(2, F, 4, 4) camera from each part's own frame, in the keyframes."""
    seen: Bools
    """(2, F) whether the part was found there."""
    labels: dict[int, Labels]
    """Of some keyframes, pictures: 0 neither, 1, 2."""


Solve = Callable[[Video, np.random.Generator], Motion]


def run_baseline(
    solve: Solve, sequence: Path, out: Path, every: int, name: str, by_paper: bool = False
) -> Reconstruction | Failure:
    """Solve a sequence folder by `solve` on every `every`-th frame, and write the result folder `out`: an answer with
    its asset, or a failure with its reason. `by_paper`: the joint's type by the paper's rule."""
    recording = read_sequence(sequence)
    seconds: dict[str, float] = {}
    start = time.perf_counter()

    def note(stage: str) -> None:
        seconds[stage] = round(time.perf_counter() - start - sum(seconds.values()), 2)

    settings = {"method": name, "every": every}
    try:
        video = read_video(recording, every)
        note("reading")
        motion = solve(video, np.random.default_rng(0))
        note("motion")
        result = assemble(video, motion, by_paper)
        note("answer")
    except UnsolvableError as error:
        failure = Failure(error.stage, error.reason, seconds)
        write_result(out, failure, settings)
        return failure
    renders, others = draw_queries(recording, result)
    note("views")
    result = replace(result, seconds=seconds)
    write_result(out, result, settings, renders or None, renders_other=others or None)
    write_asset(out / "asset", result)
    return result


def assemble(video: Video, motion: Motion, by_paper: bool) -> Reconstruction:
    """The answer for all frames. The canonical frame is the reference part's own, state zero that of the first keyframe
    in which both parts were found; frames between keyframes are interpolated. Raises UnsolvableError."""
    recording, Ts = video.recording, motion.Ts.copy()
    both = np.flatnonzero(motion.seen.all(0))
    meshes = [fuse(video, Ts, motion.seen, motion.labels, part) for part in range(2)]
    if _spread(Ts[0], motion.seen[0], meshes[0]) > _spread(Ts[1], motion.seen[1], meshes[1]):
        order = [1, 0]  # the part that moves least is the reference (the paper, sec. 3.3)
        Ts, meshes = Ts[order], [meshes[k] for k in order]
        seen = motion.seen[order]
    else:
        seen = motion.seen
    if len(both) < LEAST_POSES:
        raise UnsolvableError("joint", f"both parts were found in {len(both)} keyframes, expected {LEAST_POSES}")
    relative = se3.inverse(Ts[0]) @ Ts[1]
    home = relative[both[0]]
    meshes[1] = meshes[1].moved(home)
    Ts[1] = Ts[1] @ se3.inverse(home)
    relative = relative @ se3.inverse(home)
    relative, centre, lever = relative[both], meshes[1].vertices.mean(0), bounding_diagonal(meshes[1]) / 2
    kind = paper_joint_type(relative @ se3.pose(np.eye(3), centre)) if by_paper else None
    fit = fit_joint_of_type(relative, kind, centre, lever) if kind else fit_joint(relative, centre, lever)[0]
    every = np.arange(len(recording))
    all_Ts = [interpolate_poses(video.numbers[found], T[found], every) for T, found in zip(Ts, seen, strict=True)]
    all_states = np.interp(every, video.numbers[both], fit.states)
    masks = []
    for number in every:
        frame = recording.frame(int(number))
        posed = [mesh.moved(T[number]) for mesh, T in zip(meshes, all_Ts, strict=True)]
        masks.append(label_frame(recording.camera, frame.depth, frame.mask, posed))
    numbers = video.numbers
    was_seen = np.stack([(every >= numbers[f].min()) & (every <= numbers[f].max()) for f in seen], 1)
    return Reconstruction(
        Articulation(fit.joint(), meshes[0], meshes[1]), all_states, all_Ts[0], all_Ts[1], np.stack(masks), was_seen
    )


def _spread(Ts: Array, seen: Bools, mesh: Mesh) -> float:
    """How far, metres, a part's centre moves in the camera: standard deviation over keyframes."""
    centre = mesh.vertices.mean(0)
    path = se3.transform(Ts[seen], np.repeat(centre[None, None], int(seen.sum()), 0))[:, 0]
    return float(np.linalg.norm(path.std(0))) if len(path) else np.inf


def draw_queries(recording: Recording, result: Reconstruction) -> tuple[list[Labels], list[Labels]]:
    """The held-out views by the reference part's pose, and those by the moving part's."""
    views: tuple[list[Labels], list[Labels]] = ([], [])
    for query in recording.queries:
        q, joint = result.states[query.state_of_frame], result.articulation.joint
        by_reference = result.Ts_camera_reference[query.pose_of_frame]
        by_moving = result.Ts_camera_moving[query.pose_of_frame] @ se3.inverse(joint.transform(q))
        for pictures, T in zip(views, (by_reference, by_moving), strict=True):
            posed = join_meshes(result.articulation.posed(query.T_newcam_cam @ T, q))
            pictures.append(draw(recording.camera, posed)[1])
    return views


def write_asset(folder: Path, result: Reconstruction) -> None:
    """The answer as a URDF of two links: meshes as seen, their convex hulls for contact, masses guessed."""
    from scipy.spatial import ConvexHull

    joint, links = result.articulation.joint, []
    for name in PARTS:
        mesh = result.articulation.part(name)
        hull = ConvexHull(mesh.vertices)
        for kind, (vertices, faces) in {
            "": (mesh.vertices, mesh.faces),
            "_hull": (mesh.vertices, _outward(mesh.vertices, hull)),
        }.items():
            used, again = np.unique(faces, return_inverse=True)
            lines = [f"v {x:.7g} {y:.7g} {z:.7g}" for x, y, z in vertices[used]]
            lines += [f"f {a} {b} {c}" for a, b, c in again.reshape(-1, 3) + 1]
            atomic.write_bytes(folder / "meshes" / f"{name}{kind}.obj", ("\n".join(lines) + "\n").encode())
        low, high = mesh.vertices.min(0), mesh.vertices.max(0)
        side = high - low
        mass = DENSITY * float(np.prod(np.maximum(side, 1e-3)))
        xx, yy, zz = mass / 12 * (np.sum(side**2) - side**2)
        links.append(
            f'  <link name="{name}">\n'
            f'    <inertial><origin xyz="{_words((low + high) / 2)}"/><mass value="{mass:.6g}"/>'
            f'<inertia ixx="{xx:.6g}" ixy="0" ixz="0" iyy="{yy:.6g}" iyz="0" izz="{zz:.6g}"/></inertial>\n'
            f'    <visual><geometry><mesh filename="meshes/{name}.obj"/></geometry></visual>\n'
            f'    <collision><geometry><mesh filename="meshes/{name}_hull.obj"/></geometry></collision>\n'
            "  </link>\n"
        )
    # the child's frame stands on the axis: its meshes are moved back to the canonical frame
    body = links[1].replace("<geometry>", f'<origin xyz="{_words(-joint.pivot)}"/><geometry>')
    middle = (result.articulation.moving.vertices.min(0) + result.articulation.moving.vertices.max(0)) / 2
    body = body.replace(
        f'<origin xyz="{_words(middle)}"/><mass', f'<origin xyz="{_words(middle - joint.pivot)}"/><mass'
    )
    text = (
        f'<robot name="object">\n{links[0]}{body}'
        f'  <joint name="joint" type="{joint.type}">\n'
        '    <parent link="reference"/><child link="moving"/>\n'
        f'    <origin xyz="{_words(joint.pivot)}"/><axis xyz="{_words(joint.axis)}"/>\n'
        f'    <limit lower="{joint.lower:.6g}" upper="{joint.upper:.6g}" effort="100" velocity="10"/>\n'
        "  </joint>\n</robot>\n"
    )
    atomic.write_bytes(folder / "object.urdf", text.encode())
    source = {"dynamics": "masses are guessed from the parts' boxes"}
    write_asset_json(folder, Asset(folder / "object.urdf", "joint", "reference", "moving", source=source))


def _words(vector: Array) -> str:
    return " ".join(f"{value:.7g}" for value in vector)


def _outward(vertices: Array, hull: object) -> Array:
    """The hull's faces (F, 3), counter-clockwise seen from outside."""
    faces, normals = np.array(hull.simplices), hull.equations[:, :3]  # type: ignore[attr-defined]
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    turned = np.einsum("fk,fk->f", np.cross(b - a, c - a), normals) < 0
    return np.where(turned[:, None], faces[:, ::-1], faces)
