"""The import itself: which folder is which sequence, what may be replaced, and that the source is not trusted."""

import json
import shutil
import zipfile

import numpy as np
import pytest
from adapters_case import WRITERS, artgs, freeartgs, itaco, official_example, runs_of, truth_of, write_json
from command_line import run_command
from hypothesis import given, settings
from hypothesis import strategies as st
from mutations import MUTATED, mutated_bytes
from refusal import assert_refused
from score_files import score_results, write_data
from synthetic_case import FRAMES

from freeart21.errors import FreeArtError
from freeart21.files import checked
from freeart21.files.result import read_method, read_result
from leaderboard.adapters.importer import import_results
from leaderboard.adapters.layout import Options, layouts
from leaderboard.validate import validate_results


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


def test_a_row_says_what_the_import_did(data, tmp_path, src, few_samples):
    runs_of(src / "a")
    import_results("bundlesdf", src, data, tmp_path / "r")
    told = "import: the joint is not the method's: it was fitted"
    assert any(note.startswith(told) for note in notes_of(data, tmp_path))
    path = tmp_path / "r" / "a" / "prediction.json"
    answer = json.loads(path.read_text())
    for notes in (["\x1b[31m" + 5000 * "x", 7, None, {}], "text", {"a": 1}, ["y"] * 1000):
        write_json(path, answer | {"settings": {"import": {"notes": notes}}})
        message = [note for note in notes_of(data, tmp_path) if note.startswith("import: ")]
        assert len(message) <= 8 and all(note.isprintable() and len(note) < 400 for note in message)


def notes_of(data, folder):
    (row,) = (row for row in score_results(folder / "r", data, "itaco-1").rows if row.sequence == "a")
    return row.notes


# ---- which folder is which sequence


@pytest.mark.parametrize(
    "named, layout, folder",
    [
        ("cat_1_joint_0", "freeartgs", "cat-1-joint-0"),  # official names have no underscore
        ("Microwave-7265-joint_0-view_0", "itaco", "Microwave/7265/joint_0_bg/view_0/refinement/monst3r/chamfer/0"),
    ],
)
def test_folders_go_by_the_projects_own_names(tmp_path, src, named, layout, folder):
    data = write_data(tmp_path / "data")
    (data / "sequences" / "a").rename(data / "sequences" / named)
    benchmark = json.loads((data / "benchmark.json").read_text())
    write_json(data / "benchmark.json", benchmark | {"sequences": [named]})
    WRITERS[layout](src / folder)
    assert import_results(layout, src, data, tmp_path / "r").sequences == (named,)


def test_a_map_says_which_is_which_with_options_of_its_own(data, tmp_path, src, official):
    for folder, name in (("7128", "a"), ("45135", "b")):
        artgs(src / folder, name)
    write_json(tmp_path / "map.json", {"a": {"folder": "7128", "anchor": 4}, "b": "45135"})
    common = Options(object_poses=official, anchor=2)
    report = import_results("artgs", src, data, tmp_path / "r", common, map_file=tmp_path / "map.json")
    assert report.sequences == ("a", "b")
    assert [read_result(tmp_path / "r" / name).anchor for name in "ab"] == [4, 2]
    assert read_method(tmp_path / "r").settings["options"]["a"]["anchor"] == 4


@pytest.mark.parametrize(
    "entries, message",
    [
        ({"z": "a"}, "has no sequence 'z'"),
        ({"a": "../../etc"}, "leads out"),
        ({"a": {"folder": "a", "anchor": "1"}}, "'a': 'anchor' is '1', expected a whole number"),
        ({"a": {"folder": "a", "frame": "moon"}}, "'a': 'frame' is 'moon', expected camera, opengl"),
        ({}, "names no sequence"),
    ],
)
def test_a_map_that_is_wrong(data, tmp_path, src, official, entries, message):
    artgs(src / "a")
    write_json(tmp_path / "map.json", entries)
    options, path = Options(object_poses=official), tmp_path / "map.json"
    assert_refused(message, import_results, "artgs", src, data, tmp_path / "r", options, map_file=path)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize(
    "layout, options, sequence, message",
    [
        ("nerf", Options(), None, "unknown layout 'nerf'; known: artgs, articulate-anything"),
        ("freeartgs", Options(frame="camera"), None, "no use for --frame"),
        ("freeartgs", Options(axes="blender"), None, "'axes' is 'blender', expected opencv, opengl"),
        ("freeartgs", Options(scale=float("nan")), None, "'scale' is nan"),
        ("freeartgs", Options(), "z", "no sequence 'z'"),
        ("itaco", Options(), None, "no result of the layout itaco in a folder named as a sequence"),
        ("itaco", Options(), "a", "no result of the layout itaco"),
    ],
)
def test_options_that_are_wrong(data, tmp_path, src, layout, options, sequence, message):
    freeartgs(src / "a")
    assert_refused(message, import_results, layout, src, data, tmp_path / "r", options, sequence)
    assert not (tmp_path / "r").exists()


def test_the_objects_pose_in_the_video_has_to_be_known(data, tmp_path, src, official):
    artgs(src / "a")
    put = "artgs", src, data, tmp_path / "r"
    assert_refused(r"stands in the object's frame \(zup\).*--object-poses.*--frame camera", import_results, *put)
    known = Options(object_poses=official, anchor=FRAMES)
    assert_refused(f"anchor is frame {FRAMES}, expected 0 to {FRAMES - 1}", import_results, *put, known)
    shutil.rmtree(official / "a")
    assert_refused("no object_poses.json of a", import_results, *put, Options(object_poses=official))
    for name in ("object_poses.json", "camera_params.json"):
        path = official / "b" / name
        path.write_text(json.dumps(json.loads(path.read_text())[:5]))
    short = Options(object_poses=official / "b")
    assert_refused("5 object poses, the video has 16", import_results, "artgs", src / "a", *put[2:], short, "a")
    assert not (tmp_path / "r").exists()


# ---- what may be replaced


def test_an_older_import_of_the_same_layout_is_replaced_and_nothing_else(data, tmp_path, src):
    freeartgs(src / "a")
    out = tmp_path / "r"
    import_results("freeartgs", src, data, out)
    freeartgs(src / "b", "b")
    assert import_results("freeartgs", src, data, out).sequences == ("a", "b")
    itaco(tmp_path / "other" / "a")
    assert_refused("no older import of itaco results", import_results, "itaco", tmp_path / "other", data, out)
    (out / "a" / "mine.txt").write_text("notes")
    assert_refused("mine.txt in it would be lost", import_results, "freeartgs", src, data, out)
    assert (out / "a" / "mine.txt").read_text() == "notes"
    write_json(tmp_path / "theirs.json" / "method.json", {"schema": "freeart21/method/1", "name": "mine"})
    assert_refused("no older import", import_results, "freeartgs", src, data, tmp_path / "theirs.json")


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


# ---- nothing in the source is trusted


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


@pytest.fixture(scope="module")
def sources(tmp_path_factory):
    """Layout to a folder with its result for sequence a."""
    home = tmp_path_factory.mktemp("sources")
    official_example(home / "official" / "a", truth_of("a"))
    for layout, write in WRITERS.items():
        write(home / layout / "a")
    return home


@pytest.mark.parametrize("layout", WRITERS)
@settings(MUTATED, max_examples=8)
@given(draw=st.data())
def test_a_broken_file_is_one_clear_line(data, tmp_path, sources, layout, draw):
    """Whatever is in one of the files: a result that `validate` finds no fault in but numbers, or one line."""
    source, out = sources / layout, tmp_path / "r"
    path = draw.draw(st.sampled_from(sorted(p for p in source.rglob("*") if p.is_file())))
    whole = path.read_bytes()
    path.write_bytes(draw.draw(mutated_bytes(whole)))
    try:
        import_results(layout, source, data, out, options_of(layout, sources / "official"))
    except FreeArtError as error:
        assert "\n" not in str(error) and len(str(error)) < 1000 and not out.exists()
    else:
        assert all(fault.field for fault in validate_results(out, data).faults if fault.file.startswith("a"))
        shutil.rmtree(out)
    finally:
        path.write_bytes(whole)


# ---- clouds


# ---- the command and its page


def test_the_command(data, tmp_path, src, capsys):
    runs_of(src / "a")
    words = ("import", "bundlesdf", src, "--data", data, "--out", tmp_path / "r")
    code, out, _ = run_command(capsys, *words)
    assert code == 0 and out.splitlines()[-1] == f"{tmp_path / 'r'}: 1 answers; it lacks masks, renders"
    assert "no result for 2 sequences (b, c)" in out and "fitted to the poses" in out
    (src / "a" / "moving" / "ob_in_cam" / "0003.txt").write_text("nothing")
    code, _, err = run_command(capsys, *words)
    assert code == 1 and err.count("\n") == 1 and "0003.txt holds no 4 x 4 matrix" in err
