"""The import itself: which folder is which sequence, what may be replaced, and that the source is not trusted."""

import json
import shutil
import zipfile
from pathlib import Path

import numpy as np
import pytest
from adapters_case import WRITERS, freeartgs, itaco, official_example, paris, rsrd, truth_of, write_json
from command_line import run_command
from refusal import assert_refused
from score_files import score_results, write_data
from synthetic_case import FRAMES

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.result import read_method, read_result
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options
from leaderboard.adapters.points import SIDE, mesh_from_points
from leaderboard.adapters.registry import layouts
from leaderboard.validate import validate_results

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture
def src(tmp_path):
    return tmp_path / "theirs"


@pytest.fixture
def official(tmp_path):
    for name in ("a", "b", "c"):
        official_example(tmp_path / "official" / name, truth_of(name))
    return tmp_path / "official"


def options_of(layout, official):
    return Options(object_poses=official) if layouts()[layout].frame in ("zup", "link") else Options()


def test_every_layout_has_a_writer_here():
    assert set(WRITERS) == set(layouts())


@pytest.mark.parametrize("layout", WRITERS)
def test_an_import_is_valid_and_needs_no_truth(data, tmp_path, src, official, layout):
    blind = tmp_path / "blind"
    shutil.copytree(data, blind)
    shutil.rmtree(blind / "truth")
    for name in ("a", "b"):
        WRITERS[layout](src / name, name)
    report = import_results(layout, src, blind, tmp_path / "r", options_of(layout, official), name="theirs")
    assert report.sequences == ("a", "b") and report.missing == ("c",)
    found = validate_results(tmp_path / "r", blind)
    assert [str(fault) for fault in found.faults] == ["c is missing, expected a folder with prediction.json"]
    method = read_method(tmp_path / "r")
    assert method.name == "theirs" and method.settings["read_as"] == layouts()[layout].source
    assert "renders" in method.lacks


def test_missing_sequences_are_priced_and_lacking_numbers_are_not(data, tmp_path, src, official, few_samples):
    paris(src / "a")
    import_results("paris", src, data, tmp_path / "r", Options(object_poses=official, anchor=4))
    rows = {row.sequence: row for row in score_results(tmp_path / "r", data).rows}
    assert rows["a"].status == "ok" and rows["c"].status == "missing"
    assert rows["c"].values["axis"] == 90 and rows["c"].values["state"] is None and rows["c"].values["miou"] is None


def test_a_row_says_what_the_import_did(data, tmp_path, src, few_samples):
    rsrd(src / "a")
    import_results("rsrd", src, data, tmp_path / "r")
    assert any(
        note.startswith("import: the joint is not the method's: it was fitted") for note in notes_of(data, tmp_path)
    )
    path = tmp_path / "r" / "a" / "prediction.json"
    answer = json.loads(path.read_text())
    for notes in (["\x1b[31m" + 5000 * "x", 7, None, {}], "text", {"a": 1}, ["y"] * 1000):
        write_json(path, answer | {"settings": {"import": {"notes": notes}}})
        message = [note for note in notes_of(data, tmp_path) if note.startswith("import: ")]
        assert len(message) <= 8 and all(note.isprintable() and len(note) < 400 for note in message)
    for settings in ([], {"import": 3}, "text"):
        write_json(path, answer | {"settings": settings})
        assert not any(note.startswith("import: ") for note in notes_of(data, tmp_path))


def notes_of(data, folder):
    (row,) = (row for row in score_results(folder / "r", data, "itaco-1").rows if row.sequence == "a")
    return row.notes


# Which folder is which sequence


def test_official_names_have_no_underscore(tmp_path, src):
    data = write_data(tmp_path / "data")
    named = tmp_path / "named"
    for part in ("sequences", "truth"):
        (named / part).mkdir(parents=True)
        shutil.copytree(data / part / "a", named / part / "cat_1_joint_0")
    benchmark = json.loads((data / "benchmark.json").read_text())
    write_json(named / "benchmark.json", benchmark | {"sequences": ["cat_1_joint_0"]})
    freeartgs(src / "cat-1-joint-0")
    assert import_results("freeartgs", src, named, tmp_path / "r").sequences == ("cat_1_joint_0",)


def test_itacos_own_folders(tmp_path, src):
    data = write_data(tmp_path / "data")
    named = "Microwave-7265-joint_0-view_0"
    (data / "sequences" / "a").rename(data / "sequences" / named)
    benchmark = json.loads((data / "benchmark.json").read_text())
    write_json(data / "benchmark.json", benchmark | {"sequences": [named]})
    itaco(src / "Microwave" / "7265" / "joint_0_bg" / "view_0" / "refinement" / "monst3r" / "chamfer" / "0")
    assert import_results("itaco", src, data, tmp_path / "r").sequences == (named,)


def test_a_map_says_which_is_which_with_options_of_its_own(data, tmp_path, src, official):
    for folder, name in (("7128", "a"), ("45135", "b")):
        paris(src / folder, name)
    given = {"a": {"folder": "7128", "anchor": 4}, "b": "45135"}
    write_json(tmp_path / "map.json", given)
    given = Options(object_poses=official, anchor=2)
    report = import_results("paris", src, data, tmp_path / "r", given, map_file=tmp_path / "map.json")
    assert report.sequences == ("a", "b")
    assert [read_result(tmp_path / "r" / name).anchor for name in "ab"] == [4, 2]
    assert read_method(tmp_path / "r").settings["options"]["a"]["anchor"] == 4


@pytest.mark.parametrize(
    "given, message",
    [
        ({"z": "a"}, "has no sequence 'z'"),
        ({"a": "nowhere"}, "not a folder"),
        ({"a": "../../etc"}, "leads out"),
        ({"a": 3}, "'a' is 3, expected an object of folder"),
        ({"a": {"folder": "a", "anchors": 1}}, "has 'anchors', expected folder, frame"),
        ({"a": {"folder": "a", "anchor": "1"}}, "'a': 'anchor' is '1', expected a whole number"),
        ({"a": {"folder": "a", "frame": "moon"}}, "frame is 'moon'"),
        ({"a": {"folder": "a", "scale": -1}}, "scale is -1"),
        ({}, "names no sequence"),
    ],
)
def test_a_map_that_is_wrong(data, tmp_path, src, official, given, message):
    paris(src / "a")
    write_json(tmp_path / "map.json", given)
    with pytest.raises(FreeArtError, match=message) as error:
        import_results(
            "paris", src, data, tmp_path / "r", Options(object_poses=official), map_file=tmp_path / "map.json"
        )
    assert "\n" not in str(error.value) and not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    "layout, options, sequence, message",
    [
        ("nerf", Options(), None, "unknown layout 'nerf'; known: artgs, articulate-anything"),
        ("freeartgs", Options(frame="camera"), None, "no use for --frame"),
        ("freeartgs", Options(anchor=3), None, "no use for --anchor"),
        ("freeartgs", Options(joint="1"), None, "no use for --joint"),
        ("bundlesdf", Options(axes="opengl"), None, "no use for --axes"),
        ("freeartgs", Options(axes="blender"), None, "axes are 'blender'"),
        ("freeartgs", Options(scale=float("nan")), None, "scale is nan"),
        ("freeartgs", Options(), "z", "no sequence 'z'"),
        ("itaco", Options(), None, "no result of the layout itaco in a folder named as a sequence"),
        ("itaco", Options(), "a", "no result of the layout itaco"),
    ],
)
def test_options_that_are_wrong(data, tmp_path, src, layout, options, sequence, message):
    freeartgs(src / "a")
    with pytest.raises(FreeArtError, match=message) as error:
        import_results(layout, src, data, tmp_path / "r", options, sequence)
    assert "\n" not in str(error.value) and not (tmp_path / "r").exists()


def test_an_anchor_beyond_the_video(data, tmp_path, src, official):
    paris(src / "a")
    with pytest.raises(FreeArtError, match=f"anchor is frame 16, expected 0 to {FRAMES - 1}"):
        import_results("paris", src, data, tmp_path / "r", Options(object_poses=official, anchor=16))


def test_object_poses_of_another_sequence(data, tmp_path, src, official):
    paris(src / "a")
    shutil.rmtree(official / "a")
    with pytest.raises(FreeArtError, match=r"no object_poses.json of a"):
        import_results("paris", src, data, tmp_path / "r", Options(object_poses=official))
    for name in ("object_poses.json", "camera_params.json"):
        path = official / "b" / name
        path.write_text(json.dumps(json.loads(path.read_text())[:5]))
    with pytest.raises(FreeArtError, match="5 object poses, the video has 16"):
        import_results("paris", src / "a", data, tmp_path / "r", Options(object_poses=official / "b"), "a")


# What may be replaced


def test_an_older_import_of_the_same_layout_is_replaced_and_nothing_else(data, tmp_path, src):
    freeartgs(src / "a")
    out = tmp_path / "r"
    import_results("freeartgs", src, data, out)
    freeartgs(src / "b", "b")
    assert import_results("freeartgs", src, data, out).sequences == ("a", "b")
    rsrd(tmp_path / "other" / "a")
    assert_refused("no older import of rsrd results", import_results, "rsrd", tmp_path / "other", data, out)
    (out / "a" / "mine.txt").write_text("notes")
    assert_refused("mine.txt in it would be lost", import_results, "freeartgs", src, data, out)
    assert (out / "a" / "mine.txt").read_text() == "notes"


def test_a_folder_of_results_of_somebody_is_not_replaced(data, tmp_path, src):
    freeartgs(src / "a")
    write_json(tmp_path / "r" / "method.json", {"schema": "freeart21/method/1", "name": "mine"})
    assert_refused("no older import", import_results, "freeartgs", src, data, tmp_path / "r")


def test_all_faults_are_reported_and_nothing_is_written(data, tmp_path, src):
    for name in ("a", "b", "c"):
        freeartgs(src / name, name)
    import_results("freeartgs", src, data, tmp_path / "r")
    before = {p: p.read_bytes() for p in (tmp_path / "r").rglob("*") if p.is_file()}
    (src / "a" / "evaluation_data" / "revolute" / "joint_axis.npy").write_bytes(b"not an array")
    np.save(src / "c" / "evaluation_data" / "revolute" / "joint_value.npy", np.zeros(3))
    with pytest.raises(FreeArtError) as error:
        import_results("freeartgs", src, data, tmp_path / "r")
    lines = str(error.value).splitlines()
    assert len(lines) == 2 and lines[0].startswith("a: ") and lines[1].startswith("c: ")
    assert {p: p.read_bytes() for p in (tmp_path / "r").rglob("*") if p.is_file()} == before
    assert [p.name for p in tmp_path.iterdir() if p.name.startswith(".")] == []


# Nothing in the source is trusted


def test_links_that_lead_out_are_not_followed(data, tmp_path, src):
    freeartgs(tmp_path / "secret")
    src.mkdir()
    (src / "a").symlink_to(tmp_path / "secret")
    assert_refused("leads out of", import_results, "freeartgs", src, data, tmp_path / "r")
    (src / "a").unlink()
    freeartgs(src / "a")
    cloud = src / "a" / "evaluation_data" / "revolute" / "moving_pcd.ply"
    cloud.unlink()
    cloud.symlink_to(tmp_path / "secret" / "evaluation_data" / "revolute" / "moving_pcd.ply")
    assert_refused("leads out of", import_results, "freeartgs", src, data, tmp_path / "r")


def test_a_bomb_is_not_unpacked(data, tmp_path, src, monkeypatch):
    freeartgs(src / "a")
    path = src / "a" / "evaluation_data" / "revolute" / "moving_map.npz"
    monkeypatch.setattr(checked, "MAX_ARRAY_BYTES", 4 << 20)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.npy", bytes(5 << 20))
    assert_refused("unpacks to", import_results, "freeartgs", src, data, tmp_path / "r")


BROKEN = {
    "freeartgs": ["evaluation_data/export_manifest.json", "evaluation_data/revolute/joint_value.npy"],
    "itaco": [
        "revolute/best_loss.txt",
        "revolute/camera_poses.npy",
        "revolute/static_pcd.ply",
        "revolute/moving_map.npz",
    ],
    "rsrd": ["keyframes.txt", "part_0.ply", "dataparser_transforms.json"],
    "paris": ["save/it20000_test_motion.json", "save/it20000_static_256_thre5.0.ply"],
    "digitaltwinart": ["results/step_0004000/init_motion.json", "results/step_0004000/init_part_1.obj"],
    "artgs": ["train/ours_20000/joint_info.json", "train/ours_20000/meshes/start_0.ply"],
    "articulate-anything": ["mobility.urdf", "textured_objs/lid.obj"],
    "bundlesdf": ["moving/ob_in_cam/0003.txt", "reference/textured_mesh.obj"],
    "foundationpose": ["reference/ob_in_cam/0000.txt", "moving/mesh.obj"],
    "screwsplat": ["screws.npy", "theta.npy", "point_cloud_static.npy", "screw_confs.npy"],
}
JUNK = (
    b"",
    b"\x00\xff\xfe junk",
    b"[[[[",
    b"null",
    b"[]",
    b"{}",
    b"nan nan\nnan nan",
    b"[" * 100_000,
    b"\x93NUMPY\x01\x00junk",
)


FILES = [(layout, file) for layout, files in BROKEN.items() for file in files]


@pytest.mark.parametrize("layout, file, number", [(*one, number) for number, one in enumerate(FILES)])
def test_a_broken_file_is_one_clear_line(data, tmp_path, src, official, layout, file, number):
    """Half of the file, and a third of the junk in turn."""
    WRITERS[layout](src / "a")
    path = src / "a" / file
    whole = path.read_bytes()
    for junk in (*JUNK[number % 3 :: 3], whole[: len(whole) // 2]):
        path.write_bytes(junk)
        try:
            import_results(layout, src, data, tmp_path / "r", options_of(layout, official))
        except FreeArtError as error:
            assert "\n" not in str(error) and len(str(error)) < 1000
            assert not (tmp_path / "r").exists()
        else:  # half of a text of points, or no points at all where there need be none, may still be one
            assert junk == whole[: len(whole) // 2] or path.suffix == ".obj", junk
            assert not [f for f in validate_results(tmp_path / "r", data).faults if f.file == "a"]
            shutil.rmtree(tmp_path / "r")


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e30])
def test_numbers_that_are_none(data, tmp_path, src, value):
    freeartgs(src / "a")
    path = src / "a" / "evaluation_data" / "revolute" / "joint_pos.npy"
    np.save(path, np.array([0, value, 0]))
    try:
        import_results("freeartgs", src, data, tmp_path / "r")
    except FreeArtError as error:
        assert "finite" in str(error)
    else:
        assert value == 1e30 and any(f.field == "pivot" for f in validate_results(tmp_path / "r", data).faults)


# Clouds


def test_a_cloud_becomes_a_triangle_at_each_point_in_its_surface():
    rng = np.random.default_rng(0)
    points = np.column_stack([rng.random((500, 2)), np.zeros(500)])
    mesh = mesh_from_points(points)
    corners = mesh.vertices[mesh.faces]
    assert corners.mean(1) == pytest.approx(points, abs=1e-9)
    assert np.abs(corners[..., 2]).max() < 1e-9
    nearest = np.linalg.norm(points[:, None] - points[None], axis=-1)
    nearest[np.arange(500), np.arange(500)] = np.inf
    side = np.linalg.norm(corners[:, 0] - corners[:, 1], axis=1)
    assert side == pytest.approx(SIDE * np.median(nearest.min(1)))


@pytest.mark.parametrize("points", [np.zeros((0, 3)), np.zeros((3, 3)), np.ones((50, 3))])
def test_clouds_that_are_none(points):
    assert_refused("a cloud has", mesh_from_points, points)


# The command and its page


def test_the_command(data, tmp_path, src, capsys):
    rsrd(src / "a")
    words = ("import", "rsrd", src, "--data", data, "--out", tmp_path / "r")
    code, out, _ = run_command(capsys, *words)
    assert code == 0 and out.splitlines()[-1] == f"{tmp_path / 'r'}: 1 answers; it lacks masks, renders"
    assert "no result for 2 sequences (b, c)" in out and "fitted to the poses" in out
    (src / "a" / "part_0.ply").unlink()
    code, _, err = run_command(capsys, *words)
    assert code == 1 and err.count("\n") == 1 and "part_0.ply is missing" in err


def test_the_page_names_every_layout_and_where_it_was_read():
    page = (ROOT / "docs" / "adapters.md").read_text()
    for layout in layouts().values():
        repository = layout.source.split(":")[0]
        assert f"`{layout.name}`" in page and repository.split("@")[0] in page, layout.name
        assert repository.split("@")[1][:7] in page, layout.name
