"""Results on disk for the tests of scoring: made-up sequences, answers to them, and an asset of boxes."""

import functools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from synthetic_case import QUERIES, make_recording, make_truth, pictures, truth_as_answer

from freeart21 import se3
from freeart21.asset import Asset
from freeart21.files.asset import write_asset_json
from freeart21.files.benchmark import write_benchmark
from freeart21.files.mesh_file import write_ply
from freeart21.files.result import write_result
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from freeart21.joint import Joint
from leaderboard.protocols import PROTOCOLS, protocol_named
from leaderboard.protocols.strict import Strict
from leaderboard.rows import Scores
from leaderboard.score import score_results as score_in_processes
from leaderboard.score import summarise
from leaderboard.sequence_score import score_sequence
from leaderboard.submission import read_submitted_method


def few_samples(monkeypatch) -> None:
    """Protocols of few samples, in this process."""
    for version in (1, 2, 3):
        rules = PROTOCOLS[f"strict-{version}"]
        few = functools.partial(rules.measure, constants=Strict(version, samples=2000))
        monkeypatch.setitem(PROTOCOLS, rules.name, replace(rules, measure=few))


def write_data(folder: Path) -> Path:
    """Two revolute sequences and one prismatic, on disk."""
    for name, truth in truths().items():
        write_sequence(folder / "sequences" / name, make_recording(truth, name), 1e-4)
        write_truth(folder / "truth" / name, truth, QUERIES)
    write_benchmark(folder, "made-up", "1", "test")
    return folder


def truths():
    return {"a": make_truth("revolute", 0), "b": make_truth("prismatic", 1), "c": make_truth("revolute", 2)}


score_results = functools.partial(score_in_processes, limit_s=None)  # in this process, where `few_samples` holds


def score_one(data, folder, name="a"):
    return score_sequence(folder, data / "sequences" / name, data / "truth" / name)


def table_of(folder: Path, data: Path, protocol: str, facts: dict) -> Scores:
    """The table of a method's results, scored in this process, of a benchmark of these facts."""
    method, _ = read_submitted_method(folder)
    places = [(folder / name, data / "sequences" / name, data / "truth" / name) for name in "abc"]
    rows = tuple(score_sequence(*place, protocol, lacks=method.lacks) for place in places)
    made_with = {"freeart21": "1", "commit": "abc", "machine": {"system": "x"}, "libraries": {}}
    return Scores(protocol, method, facts, rows, summarise(rows, protocol_named(protocol)), None, (), made_with)


def submit(folder, truth, answer=None, renders=True):
    write_result(folder, answer or truth_as_answer(truth), renders=pictures(truth) if renders else None)
    return folder


def submit_with_asset(folder, truth, *asset, **options):
    """The truth as an answer, with `write_asset`'s asset: by default that of the true joint."""
    submit(folder, truth)
    write_asset(folder / "asset", *(asset or (truth.articulation.joint,)), **options)
    return folder


def assert_penalised(row, truth):
    revolute = truth.articulation.joint.type == "revolute"
    motion = np.ptp(truth.states) * (np.rad2deg(1) if revolute else 100 / truth.diagonal)
    expected = {
        "joint_type": 0,
        "axis": 90,
        "position": 100,
        "position_line": 100,
        "state": motion,
        "state_all": motion,
        "miou": 0,
        "pose_rotation": 180,
        "pose_translation": 100,
        "pose_moving_rotation": 180,
        "pose_moving_translation": 100,
        **dict.fromkeys((f"chamfer_{part}{of}" for part in "wms" for of in ("", "_parts")), 100),
        "fscore": 0,
        "fscore_parts": 0,
        "psnr": 0,
        "ssim": 0,
    }
    if not revolute:
        expected |= {"position": None, "position_line": None}
    if "silhouette" in row.values:  # strict-3
        expected = {id: value for id, value in expected.items() if id in row.values}
        expected |= {"depth_median": 100, "depth_95": 100, "silhouette": 0, "area": 100, "view_iou": 0}
    assert row.values == pytest.approx(expected)
    assert row.values_cm["chamfer_w"] == pytest.approx(100 * truth.diagonal)


def write_asset(
    folder: Path, joint: Joint, T_canonical_reference=None, state_zero=0.0, limits=(-2.0, 2.0), parts=None, urdf=None
) -> None:
    """A base and a lid, joined as `joint`, whose base link sits in the canonical frame as given.

    They look like `parts` (meshes at state zero, canonical frame), the made-up object's own when not given; `urdf`
    changes the text of the URDF.
    """
    T = np.eye(4) if T_canonical_reference is None else T_canonical_reference
    here = joint.moved(se3.inverse(T))
    axis = _rpy(0.3, -0.2, 0.5).T @ here.axis
    turned = Joint("", joint.type, axis, np.zeros(3), -np.inf, np.inf).transform(state_zero)
    T_base_lid = se3.pose(_rpy(0.3, -0.2, 0.5), here.pivot) @ turned
    looks = parts or make_truth().articulation
    for link, mesh, T_link in (("base", looks.reference, T), ("lid", looks.moving, T @ T_base_lid)):
        write_ply(folder / "meshes" / f"{link}.ply", mesh.moved(se3.inverse(T_link)))
    link = (
        '<link name="{0}"><inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/>'
        '</inertial><visual><geometry><mesh filename="meshes/{0}.ply"/></geometry></visual>'
        '<collision><geometry><box size="0.3 0.2 0.1"/></geometry></collision></link>'
    )
    triple = "{:.12g} {:.12g} {:.12g}".format
    text = (
        f'<robot name="made">{link.format("base")}{link.format("lid")}<joint name="{joint.name}" type="{joint.type}">'
        f'<parent link="base"/><child link="lid"/><origin xyz="{triple(*here.pivot)}" rpy="0.3 -0.2 0.5"/>'
        f'<axis xyz="{triple(*axis)}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="1" velocity="1"/></joint></robot>'
    )
    changed = urdf(text) if urdf else text
    assert urdf is None or changed != text
    (folder / "made.urdf").write_text(changed)
    write_asset_json(folder, Asset(folder / "made.urdf", joint.name, "base", "lid", T, state_zero))


def _rpy(r, p, y):
    return se3.exp_so3([0, 0, y]) @ se3.exp_so3([0, p, 0]) @ se3.exp_so3([r, 0, 0])
