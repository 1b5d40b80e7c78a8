"""A file of Gaussians keeps what it is given, is what other programs read and write, and can do no harm."""

import importlib.util
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_bytes, reads_or_refuses
from refusal import assert_refused
from score_files import truths, write_data
from synthetic_case import truth_as_answer

from freeart21 import se3
from freeart21.errors import FreeArtError
from freeart21.files.gaussians import MAX_GAUSSIANS, SH_0, read_gaussians, write_gaussians
from freeart21.files.result import read_result, write_result
from freeart21.gaussians import LIGHT_TERMS, Gaussians
from freeart21.reconstruction import Reconstruction
from leaderboard.validate import validate_results

RAW = [
    *("x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2", "opacity"),
    *("scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3", "part_weight"),
]


def make_gaussians(n: int = 50, light: int | None = 9) -> Gaussians:
    rng = np.random.default_rng(n)

    def unit(width: int) -> np.ndarray:
        values = rng.normal(size=(n, width))
        return values / np.linalg.norm(values, axis=1, keepdims=True)

    arrays = (
        rng.normal(0, 0.2, (n, 3)),
        unit(4),
        np.exp(rng.uniform(-12, -3, (n, 3))),
        rng.uniform(0, 1, n),
        rng.uniform(0, 1, (n, 3)),
        np.round(rng.uniform(0, 1, n), 3),
        unit(3),
    )
    terms = None if light is None else rng.normal(size=(light, 3)).astype(np.float32)
    return Gaussians(*(a.astype(np.float32) for a in arrays), light=terms)


def table(path: Path) -> tuple[list[str], dict[str, np.ndarray]]:
    """The header's lines and the columns of a PLY of floats: what a reader elsewhere does."""
    head, body = path.read_bytes().split(b"end_header\n", 1)
    lines = head.decode("ascii").split("\n")
    names = [line.split()[2] for line in lines if line.startswith("property float ")]
    return lines, dict(zip(names, np.frombuffer(body, "<f4").reshape(-1, len(names)).T, strict=True))


def write_table(
    path: Path, columns: dict[str, np.ndarray], kind: str = "float", more: str = "", end: str = "\n"
) -> None:
    types = {"float": "<f4", "double": "<f8"}
    rows = np.column_stack(list(columns.values())).astype(types[kind])
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(rows)}"]
    head += [f"property {kind} {name}" for name in columns] + more.split("\n") * bool(more) + ["end_header"]
    path.write_bytes((end.join(head) + end).encode() + rows.tobytes())


@pytest.mark.parametrize("light", [None, *LIGHT_TERMS])
def test_gaussians_round_trip(tmp_path, light):
    given = make_gaussians(light=light)
    write_gaussians(tmp_path / "a.ply", given)
    back = read_gaussians(tmp_path / "a.ply", needs_parts=True)
    for name in ("means", "quaternions", "normals", "part_weights", "colours", "opacities"):
        assert np.abs(getattr(back, name) - getattr(given, name)).max() < 3e-7, name
    assert np.array_equal(back.means, given.means) and np.array_equal(back.part_weights, given.part_weights)
    assert np.abs(back.scales / given.scales - 1).max() < 2e-6
    assert (back.light is None) if light is None else np.array_equal(back.light, given.light)
    assert len((tmp_path / "a.ply").read_bytes().split(b"end_header")[0]) < 8192, "where other readers stop looking"


def test_opacities_and_scales_at_their_ends_stay_finite(tmp_path):
    given = make_gaussians(3)
    ends = replace(given, opacities=np.array([0, 1, 0.5], np.float32), scales=np.zeros((3, 3), np.float32))
    write_gaussians(tmp_path / "a.ply", ends)
    assert all(np.isfinite(column).all() for column in table(tmp_path / "a.ply")[1].values())
    back = read_gaussians(tmp_path / "a.ply")
    assert back.opacities.tolist() == pytest.approx([1e-9, 1, 0.5], rel=1e-5, abs=0)
    assert back.scales == pytest.approx(1e-12, rel=1e-5)
    columns = table(tmp_path / "a.ply")[1]
    write_table(tmp_path / "a.ply", columns | {"scale_0": np.full(3, -3e38), "opacity": np.array([-3e38, 3e38, 0])})
    back = read_gaussians(tmp_path / "a.ply")
    assert back.scales.min() > 0 and back.opacities.tolist() == [0, 1, 0.5]


def test_the_file_is_what_viewers_expect(tmp_path):
    given = make_gaussians()
    write_gaussians(tmp_path / "a.ply", given)
    lines, columns = table(tmp_path / "a.ply")
    assert lines[:2] == ["ply", "format binary_little_endian 1.0"] and "element vertex 50" in lines
    assert list(columns) == RAW
    stack = lambda *names: np.stack([columns[name] for name in names], -1)  # noqa: E731
    assert np.exp(stack("scale_0", "scale_1", "scale_2")) == pytest.approx(given.scales, rel=1e-5)
    assert stack("f_dc_0", "f_dc_1", "f_dc_2") * SH_0 + 0.5 == pytest.approx(given.colours, abs=1e-6)
    assert stack("rot_0", "rot_1", "rot_2", "rot_3") == pytest.approx(given.quaternions)
    assert 1 / (1 + np.exp(-columns["opacity"])) == pytest.approx(given.opacities, abs=1e-6)


@pytest.mark.parametrize("kind", ["float", "double"])
@pytest.mark.parametrize("end", ["\n", "\r\n"])
def test_a_plain_3dgs_file_in_any_order_is_one_still_part(tmp_path, kind, end):
    given = make_gaussians()
    write_gaussians(tmp_path / "a.ply", given)
    columns = table(tmp_path / "a.ply")[1]
    for name in ("nx", "ny", "nz", "part_weight"):
        del columns[name]
    for k in range(45):
        columns[f"f_rest_{k}"] = np.full(50, np.nan)
    columns |= {f"rot_{k}": 3 * columns[f"rot_{k}"] for k in range(4)}
    columns["f_dc_0"] = columns["f_dc_0"] * 0 + 9
    faces = "element face 1\nproperty list uchar int vertex_indices"
    write_table(tmp_path / "b.ply", dict(reversed(columns.items())), kind, faces, end)
    back = read_gaussians(tmp_path / "b.ply")
    assert (back.part_weights == 1).all() and (back.colours[:, 0] == 1).all() and back.light is None
    assert back.means == pytest.approx(given.means) and back.quaternions == pytest.approx(given.quaternions, abs=1e-6)
    thinnest = se3.rotation_from_wxyz(given.quaternions)[np.arange(50), :, given.scales.argmin(1)]
    assert np.abs((thinnest * back.normals).sum(1)) == pytest.approx(np.ones(50), abs=1e-6)
    assert ((back.means - np.median(back.means, 0)) * back.normals).sum(1).min() >= -1e-6, "normals point outwards"
    with pytest.raises(FreeArtError, match=r"b\.ply .*no part_weight .*which part moves is not known"):
        read_gaussians(tmp_path / "b.ply", needs_parts=True)


HEAD = b"ply\nformat binary_little_endian 1.0\n"


def test_a_promise_of_more_rows_than_there_are_takes_no_memory(tmp_path):
    """Four million rows of 500 doubles would be 16 GB."""
    names = [*RAW, *(f"f_rest_{k}" for k in range(482))]
    head = HEAD.decode() + f"element vertex {MAX_GAUSSIANS}\n" + "".join(f"property double {n}\n" for n in names)
    (tmp_path / "a.ply").write_bytes(head.encode() + b"end_header\n" + bytes(8 * 500))
    assert_refused(f"ends after 1 of {MAX_GAUSSIANS} Gaussians", read_gaussians, tmp_path / "a.ply")


def test_a_quaternion_of_length_zero_and_numbers_beyond_floats_are_named(tmp_path):
    write_gaussians(tmp_path / "a.ply", make_gaussians())
    good = table(tmp_path / "a.ply")[1]
    write_table(tmp_path / "b.ply", good | {f"rot_{k}": good["rot_0"] * (np.arange(50) != 3) for k in range(4)})
    assert_refused("the quaternion of Gaussian 3 is zero", read_gaussians, tmp_path / "b.ply")
    write_table(tmp_path / "c.ply", good | {"x": np.full(50, 1e200)}, "double")
    assert_refused("means are not all finite", read_gaussians, tmp_path / "c.ply")


# ---------------------------------------------------------------- another program

needs_gsply = pytest.mark.skipif(importlib.util.find_spec("gsply") is None, reason="gsply is not installed")


@needs_gsply
def test_gsply_reads_what_we_write(tmp_path):
    import gsply

    given = make_gaussians()
    write_gaussians(tmp_path / "a.ply", given)
    theirs = gsply.plyread(tmp_path / "a.ply")
    assert np.array_equal(theirs.means, given.means) and np.array_equal(theirs.quats, given.quaternions)
    assert np.exp(theirs.scales) == pytest.approx(given.scales, rel=1e-5)
    assert 1 / (1 + np.exp(-theirs.opacities)) == pytest.approx(given.opacities, abs=1e-6)
    assert theirs.sh0 * SH_0 + 0.5 == pytest.approx(given.colours, abs=1e-6)


# ---------------------------------------------------------------- in a result


def test_a_result_carries_its_appearance_and_is_replaced_with_it(tmp_path):
    data = write_data(tmp_path / "data")
    results, (name, truth) = tmp_path / "results", next(iter(truths().items()))
    answer = replace(truth_as_answer(truth), appearance=make_gaussians())
    write_result(results / name, answer)
    back = read_result(results / name)
    assert isinstance(back, Reconstruction)
    assert np.array_equal(back.appearance.means, make_gaussians().means) and back.appearance.light is not None
    left_alone = read_result(results / name, appearance=False)
    assert isinstance(left_alone, Reconstruction) and left_alone.appearance is None
    assert not [fault for fault in validate_results(results, data).faults if "gaussians" in str(fault)]
    (results / name / "gaussians.ply").write_bytes(b"ply\n")
    (fault,) = [fault for fault in validate_results(results, data).faults if "gaussians" in str(fault)]
    assert not fault.fatal and fault.file == f"{name}/gaussians.ply", "nothing is measured of it"
    assert_refused(r"gaussians\.ply is not a readable PLY file of Gaussians", read_result, results / name)
    write_result(results / name, truth_as_answer(truth))
    assert not (results / name / "gaussians.ply").exists() and read_result(results / name).appearance is None


@settings(MUTATED, max_examples=300)
@given(data=st.data())
def test_no_bytes_do_more_than_raise_one_clear_line(tmp_path, data):
    write_gaussians(tmp_path / "a.ply", make_gaussians(20))
    (tmp_path / "a.ply").write_bytes(data.draw(mutated_bytes((tmp_path / "a.ply").read_bytes())))
    line = reads_or_refuses(read_gaussians, tmp_path / "a.ply")
    assert line.isprintable() and len(line) < 500
