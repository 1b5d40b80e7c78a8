"""Contact shapes of given parts by ours and by CoACD, side by side.

    .venv/bin/pip install coacd
    .venv/bin/python -m benchmarks.contact_shapes results/NAME/drawer_unit-v1/asset:reference shared/laptop/laptop.urdf

takes the visual mesh of each part (an asset's folder or a URDF; with :LINK that link alone, else all of them), makes
contact shapes of it by `fine` and `fast` (`export.collision`) and by CoACD (Wei et al., SIGGRAPH 2022) with its
thresholds .05, which is its default, and .02, each in a process of its own, and measures from the shapes:
- their number, and the processor seconds of making them, with compiled code warm;
- how far the part's outer surface lies from all of them at most (inside a shape counts as none), how far they stand out
  of it at most, and its median distance to their surface;
- the volume that they add to a closed part and that they lack of it;
- steps a processor second of two bodies of these shapes, one dropped on the other, in SAPIEN.
Prints a row a part, the worst of ours against CoACD's default first, and writes benchmarks/results/contact_shapes.json.
Cuts at the ground and at the other part, which `export` makes later, are not made: CoACD knows neither.
"""

from __future__ import annotations

import json
import sys
import tempfile
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from manifold3d import Manifold, OpType

from benchmarks.assets import join_visuals
from benchmarks.common import RESULTS, ROOT, format_number, make_table, run_cli, run_within, wide_console, write_report
from export.carving import make_solid
from export.collision import PRESETS, Collision, convex_hull, make_collision
from export.decomposition import MIN_THICKNESS_M
from export.fidelity import measure_fidelity
from export.outer_surface import sample_outer_surface
from export.primitives import Box, Cylinder, Sphere
from freeart21.errors import FreeArtError
from freeart21.files import atomic, checked
from freeart21.mesh import Mesh
from freeart21.view.link_shapes import read_shown

SCHEMA = "freeart21/benchmark-contact-shapes/1"
MAKERS = ("fine", "fast", "coacd .05", "coacd .02")
"""Presets of ours, and CoACD with a threshold: the finer after the coarser, as it takes about three times as
long."""
MEASURING_S = 60.0
"""Processor seconds that a process may take beside the making."""
DENSITY = 500.0
"""kg/m^3 of the dropped bodies, each of its shapes' volumes."""
STEP_S, STEPS = 0.002, 500
"""s, and how many of them: a body falls its own size in the first and lies on the other in the last."""
COLUMNS = {
    "shapes": ("shapes", 0),
    "cpu_s": ("cpu s", 0),
    "away_mm": ("surface away, mm", 1),
    "out_mm": ("stand out, mm", 1),
    "median_mm": ("median, mm", 2),
    "added_pc": ("added, %", 1),
    "lacking_pc": ("lacking, %", 1),
    "steps_per_s": ("steps a cpu s", 0),
}
"""Of a maker's numbers: the head of its column, and decimals."""


def main(parts: tuple[str, ...], /, limit_s: float = 240.0, out: Path = RESULTS / "contact_shapes.json") -> None:
    """Compare contact shapes.

    Args:
        parts: Assets' folders or URDFs, with :LINK for one link alone. What is absent is left out.
        limit_s: Processor seconds that making a part's shapes may take.
        out: The JSON file.
    """
    try:
        import coacd  # noqa: F401
    except ImportError:
        raise FreeArtError("there is nothing to compare with: pip install coacd") from None
    console, rows, left_out = wide_console(), [], {}
    with tempfile.TemporaryDirectory() as folder:
        for part in parts:
            try:
                found = read_parts(part)
            except FreeArtError as error:
                left_out[part] = str(error)
                console.print(f"left out: {error}", highlight=False)
                continue
            for name, mesh in found.items():
                rows.append(_row(name, mesh, limit_s, Path(folder)))
                console.print(json.dumps(rows[-1]), highlight=False)
    rows.sort(key=_badness, reverse=True)
    console.print(table_of(rows))
    settings = {"limit_s": limit_s, "step_s": STEP_S, "steps": STEPS, "coacd": coacd_version()}
    write_report(out, settings, rows=rows, left_out=[Path(part).name for part in left_out])


def read_parts(part: str) -> dict[str, Mesh]:
    """The visual meshes that `ASSET`, `ASSET:LINK` or the like of a URDF names, by object and link; FreeArtError."""
    place, _, link = part.partition(":")
    path = Path(place)
    urdf = next((path / n for n in ("object.urdf", "mobility.urdf") if (path / n).is_file()), path)
    if not urdf.is_file():
        raise FreeArtError(f"{place}: there is no URDF")
    shown = read_shown(urdf, urdf.parent)
    if shown.missing:
        raise FreeArtError(f"{urdf}: {shown.missing[0]} is missing")
    links = [name for name, pieces in shown.visuals.items() if pieces]
    if link and link not in links:
        raise FreeArtError(f"{urdf} has no visual of a link '{link}'; there are {', '.join(links)}")
    names = [folder.name for folder in urdf.parents if folder.name != "asset"]
    return {f"{names[0]} {name}": join_visuals(shown, name) for name in ([link] if link else links)}


def _row(name: str, mesh: Mesh, limit_s: float, folder: Path) -> dict[str, Any]:
    """A part by every maker."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    row: dict[str, Any] = {
        "part": name,
        "diagonal_mm": round(1e3 * float(np.linalg.norm(solid.extents)), 1),
        "triangles": len(mesh.faces),
        "closed": bool(solid.is_watertight),
        "makers": {},
    }
    np.savez(folder / "mesh.npz", vertices=mesh.vertices, faces=mesh.faces)
    slow = False
    for maker in MAKERS:
        if slow:
            row["makers"][maker] = {"status": "not tried, it would take too long"}
            continue
        (folder / "found.json").unlink(missing_ok=True)
        code = f"from benchmarks.contact_shapes import measure_in; measure_in({str(folder)!r}, {maker!r})"
        ended = run_within(limit_s + MEASURING_S, [sys.executable, "-c", code], folder)
        if (folder / "found.json").is_file():
            row["makers"][maker] = found = checked.read_json(folder / "found.json", SCHEMA)["found"]
            slow = maker not in PRESETS and found["cpu_s"] > limit_s / 3
        else:
            status = f"over {limit_s:g} s" if ended.code is None else ended.last
            slow = maker not in PRESETS and ended.code is None
            row["makers"][maker] = {"status": status.replace(str(ROOT), "")}
    return row


# --- one part by one maker, in a process of its own -------------------------------------------------------------------


def measure_in(folder: str, maker: str) -> None:
    """Read mesh.npz of a folder, make contact shapes, and write their numbers as found.json."""
    with np.load(Path(folder) / "mesh.npz") as read:
        mesh = Mesh(read["vertices"], read["faces"])
    make_shapes(_WARM, "fine")
    begin = time.process_time()
    made = make_shapes(mesh, maker)
    seconds = time.process_time() - begin
    found = {"status": "ok", "cpu_s": round(seconds, 2)} | measure_shapes(mesh, made)
    atomic.write_json(Path(folder) / "found.json", {"schema": SCHEMA, "found": found})


_WARM = Mesh(
    np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], float),
    np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
)


def make_shapes(mesh: Mesh, maker: str) -> Collision:
    """Contact shapes of a mesh by one of `MAKERS`."""
    if maker in PRESETS:
        return make_collision(mesh, PRESETS[maker])
    import coacd

    coacd.set_log_level("error")
    threshold = float(maker.split()[1])
    pieces = coacd.run_coacd(coacd.Mesh(mesh.vertices, mesh.faces), threshold=threshold)
    hulls = tuple(convex_hull(np.asarray(points, float), MIN_THICKNESS_M, 256) for points, _ in pieces)
    return Collision(hulls, (), sample_outer_surface(mesh))


def coacd_version() -> str:
    """Of the installed package."""
    from importlib.metadata import version

    return version("coacd")


def measure_shapes(mesh: Mesh, made: Collision) -> dict[str, float | None]:
    """The numbers of a part's contact shapes."""
    fidelity = measure_fidelity(made.surface, made.shapes)
    volumes = compare_volumes(mesh, made.shapes)
    return {
        "shapes": len(made.shapes),
        "primitives": len(made.primitives),
        "away_mm": round(1e3 * fidelity.uncovered, 3),
        "out_mm": round(1e3 * fidelity.outward, 3),
        "median_mm": round(1e3 * fidelity.median, 3),
        "added_pc": None if volumes is None else round(100 * volumes[0], 2),
        "lacking_pc": None if volumes is None else round(100 * volumes[1], 2),
        "steps_per_s": round(count_steps(made), 0),
    }


def compare_volumes(mesh: Mesh, shapes: Sequence[Mesh]) -> tuple[float, float] | None:
    """Shares of a part's volume that the shapes fill beyond it, and that they leave empty; None of an open part."""
    part, solids = make_solid(mesh), [make_solid(shape) for shape in shapes]
    if part is None or not all(solids):
        return None
    union = Manifold.batch_boolean(solids, OpType.Add)
    both = (union ^ part).volume()
    return (union.volume() - both) / part.volume(), 1 - both / part.volume()


def count_steps(made: Collision) -> float:
    """Steps a processor second of two bodies of these shapes in SAPIEN, the second dropped on the first."""
    import sapien
    from sapien import physx

    scene = sapien.Scene([physx.PhysxCpuSystem()])
    scene.physx_system.timestep = STEP_S
    scene.add_ground(0.0, render=False)
    corners = np.concatenate([shape.vertices for shape in made.shapes])
    low, high = corners.min(0), corners.max(0)
    middle, size = 0.5 * (low + high), high - low
    for k in range(2):
        body = physx.PhysxRigidDynamicComponent()
        for shape in sapien_shapes(made, middle):
            shape.set_density(DENSITY)
            body.attach(shape)
        entity = sapien.Entity()
        entity.add_component(body)
        entity.set_pose(sapien.Pose([0.05 * size[0] * k, 0.0, (0.55 + 1.1 * k) * size[2]]))
        scene.add_entity(entity)
        body.set_linear_damping(0.0)
        body.set_sleep_threshold(0.0)
    begin = time.process_time()
    for _ in range(STEPS):
        scene.step()
    return STEPS / (time.process_time() - begin)


def sapien_shapes(made: Collision, middle: np.ndarray) -> list[Any]:
    """SAPIEN's shapes, with `middle` (3,) m as origin."""
    import sapien
    from sapien import physx

    material = physx.PhysxMaterial(0.5, 0.5, 0.0)
    found: list[Any] = [
        physx.PhysxCollisionShapeConvexMesh(
            np.asarray(hull.vertices - middle, np.float32), np.ones(3, np.float32), material
        )
        for hull in made.hulls
    ]
    for primitive in made.primitives:
        T = np.array(primitive.T_link_shape)
        T[:3, 3] -= middle
        match primitive:
            case Box():
                shape = physx.PhysxCollisionShapeBox(np.asarray(primitive.size / 2, np.float32), material)
            case Cylinder():  # SAPIEN's lie along x
                shape = physx.PhysxCollisionShapeCylinder(primitive.radius, primitive.length / 2, material)
                T[:3, :3] = T[:3, [2, 0, 1]]
            case Sphere():
                shape = physx.PhysxCollisionShapeSphere(primitive.radius, material)
        shape.set_local_pose(sapien.Pose(np.asarray(T, np.float32)))
        found.append(shape)
    return found


# --- tables -----------------------------------------------------------------------------------------------------------


def _badness(row: dict[str, Any]) -> float:
    """How many times further from the surface, either way, `fine` is than CoACD's default; 0 where that has none."""
    ours, theirs = (
        max(found["away_mm"], found["out_mm"]) if "away_mm" in found else None
        for found in (row["makers"]["fine"], row["makers"]["coacd .05"])
    )
    return float("inf") if ours is None else 0.0 if theirs is None else ours / max(theirs, 1e-3)


def table_of(rows: Sequence[dict[str, Any]]) -> Any:
    """A table of rows: a line for each part and maker."""
    cells = []
    for row in rows:
        for maker, found in row["makers"].items():
            first = (
                [row["part"], f"{row['diagonal_mm']:.0f}", f"{_badness(row):.1f}"] if maker == MAKERS[0] else [""] * 3
            )
            numbers = [format_number(found.get(column), digits) for column, (_, digits) in COLUMNS.items()]
            cells.append([*first, maker, *numbers, "" if found["status"] == "ok" else found["status"]])
    head = ["part", "diagonal, mm", "worse, times", "by", *(name for name, _ in COLUMNS.values()), ""]
    return make_table("", head, cells, texts=("by", ""))


if __name__ == "__main__":
    run_cli(main)
