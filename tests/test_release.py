"""Published forms of a data folder, each read back by its readers."""

from __future__ import annotations

import json
import shutil
import sys
import tarfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused
from score_files import truths, write_data
from synthetic_case import HEIGHT, WIDTH

from freeart21 import se3
from freeart21.articulation import PARTS
from freeart21.camera import Camera
from freeart21.files.benchmark import read_benchmark, write_benchmark
from freeart21.files.data_card import write_card_of
from freeart21.files.mesh_file import read_ply
from freeart21.files.verify import differing_files, listed_files
from leaderboard.pack import pack_public
from leaderboard.release.bop import silhouette, write_bop
from leaderboard.release.coco import run_lengths, write_coco
from leaderboard.release.shards import write_shards


@pytest.fixture(scope="module")
def data(tmp_path_factory):
    folder = write_data(tmp_path_factory.mktemp("release") / "data")
    write_card_of(folder)
    return folder


def unpack(shard: Path, to: Path) -> Path:
    with tarfile.open(shard) as archive:
        assert all(entry.isfile() and entry.mtime == 315532800 for entry in archive)
        archive.extractall(to, filter="data")
    return to / shard.stem


def test_every_shard_is_a_whole_data_folder(data, tmp_path):
    pytest.importorskip("pyarrow")
    assert write_shards([data], tmp_path / "out", per_shard=2) == 2
    shards = sorted((tmp_path / "out/shards").iterdir())
    folders = [unpack(shard, tmp_path / "unpacked") for shard in shards]
    assert [read_benchmark(folder).sequences for folder in folders] == [("a", "b"), ("c",)]
    for folder in folders:
        assert list(differing_files(folder, listed_files(folder))) == []
    for path in (data / "sequences/c").rglob("*.png"):
        assert (folders[1] / path.relative_to(data)).read_bytes() == path.read_bytes()
    assert write_shards([data], tmp_path / "one") == 1
    (one,) = (tmp_path / "one/shards").iterdir()
    assert (unpack(one, tmp_path / "whole") / "benchmark.json").read_bytes() == (data / "benchmark.json").read_bytes()
    write_shards([data], tmp_path / "again", per_shard=2)
    for path in (tmp_path / "out").rglob("*"):
        if path.is_file():
            assert path.read_bytes() == (tmp_path / "again" / path.relative_to(tmp_path / "out")).read_bytes()


def test_many_folders_are_one_release_and_faults_are_refused(data, tmp_path, monkeypatch):
    pytest.importorskip("pyarrow")
    more = tmp_path / "more"
    for half in ("sequences", "truth"):
        shutil.copytree(data / half / "a", more / half / "d")
    write_benchmark(more, "made-up", "1", "test")
    assert write_shards([data, more], tmp_path / "out", per_shard=3) == 2
    assert len((tmp_path / "out/sequences.jsonl").read_text().splitlines()) == 4
    assert_refused("a is in two of the folders", write_shards, [data, data], tmp_path / "twice")
    write_benchmark(more, "other", "1", "test")
    assert_refused("is other 1, test; expected made-up 1", write_shards, [data, more], tmp_path / "two")
    picture = more / "sequences/d/rgb/00001.png"
    picture.write_bytes(picture.read_bytes() + b"x")
    assert_refused("differs from its hash", write_shards, [more], tmp_path / "broken")
    assert_refused("--per-shard is 0", write_shards, [data], tmp_path / "none", 0)
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    assert_refused(r"needs pyarrow: pip install 'freeart21\[release\]'", write_shards, [data], tmp_path / "bare")
    assert not any((tmp_path / name).exists() for name in ("twice", "two", "broken", "none", "bare"))


def test_the_command_writes_each_form(data, tmp_path, capsys):
    pytest.importorskip("pyarrow")
    for form, words in (("shards", "1 shard"), ("coco", "annotations"), ("bop", "3 scenes")):
        code, out, err = run_command(capsys, "release", data, "--to", form, "--out", tmp_path / form)
        assert code == 0, err
        assert out.endswith(f"{words}\n")
    pack_public(data, tmp_path / "public", tmp_path / "key")
    for form in ("coco", "bop"):
        code, _, err = run_command(capsys, "release", tmp_path / "public", "--to", form, "--out", tmp_path / "x")
        assert code == 1 and "packed without its truth" in err and not (tmp_path / "x").exists()
    code, _, err = run_command(capsys, "release", data, data, "--to", "coco", "--out", tmp_path / "x")
    assert code == 1 and "one data folder" in err


def test_pycocotools_reads_the_masks(data, tmp_path):
    coco = pytest.importorskip("pycocotools.coco")
    n = write_coco(data, tmp_path / "coco")
    found = coco.COCO(tmp_path / "coco/instances.json")
    assert len(found.anns) == n > 60 and [c["name"] for c in found.loadCats([1, 2])] == [
        "reference part",
        "moving part",
    ]
    known = truths()
    for annotation in found.loadAnns(found.getAnnIds()):
        (image,) = found.loadImgs(annotation["image_id"])
        labels = known[image["sequence"]].part_mask(image["frame"])
        mask = labels == annotation["category_id"]
        assert np.array_equal(found.annToMask(annotation) > 0, mask) and annotation["area"] == mask.sum()
        x, y, w, h = map(int, annotation["bbox"])
        assert mask[y : y + h, x : x + w].sum() == mask.sum() and mask[y].any() and mask[:, x + w - 1].any()
        assert (data / image["file_name"]).is_file()


def test_run_lengths_begin_with_what_is_off():
    assert run_lengths(np.array([[1, 0], [1, 1]], bool)) == [0, 2, 1, 1]
    assert run_lengths(np.array([[0, 1], [0, 0]], bool)) == [2, 1, 1]
    assert run_lengths(np.zeros((2, 2), bool)) == [4] and run_lengths(np.ones((2, 2), bool)) == [0, 4]


def test_bop_has_poses_in_millimetres_and_pixels_from_whole_numbers(data, tmp_path):
    assert write_bop(data, tmp_path / "bop") == 3
    known = truths()
    for k, name in enumerate("abc"):
        scene, truth = tmp_path / "bop/test" / f"{k + 1:06d}", known[name]
        cameras, poses, infos = (
            json.loads((scene / f"{file}.json").read_text()) for file in ("scene_camera", "scene_gt", "scene_gt_info")
        )
        assert len(cameras) == len(poses) == len(infos) == len(truth)
        K = np.array(cameras["3"]["cam_K"]).reshape(3, 3)
        ours = Camera.from_fov(WIDTH, HEIGHT, 0.6)
        for part, pose in enumerate(poses["3"]):
            assert pose["obj_id"] == 2 * k + part + 1
            model = read_ply(tmp_path / "bop/models" / f"obj_{pose['obj_id']:06d}.ply")[0].vertices
            there = model @ np.array(pose["cam_R_m2c"]).reshape(3, 3).T + np.array(pose["cam_t_m2c"])
            at = (there @ K.T)[:, :2] / there[:, 2:]  # OpenCV's way: the first pixel's centre is 0
            T = (truth.Ts_camera_reference, truth.Ts_camera_moving)[part][3]
            points = se3.transform(T, truth.articulation.part(PARTS[part]).vertices)
            expected = (points @ ours.K.T)[:, :2] / points[:, 2:] - 0.5
            assert np.allclose(at, expected, atol=1e-6) and np.allclose(there, 1000 * points, atol=1e-6)
            mask = cv2.imread(str(scene / "mask_visib" / f"000003_{part:06d}.png"), -1) > 0
            assert np.array_equal(mask, truth.part_mask(3) == part + 1)
            info = infos["3"][part]
            assert info["px_count_visib"] == mask.sum() and 0 < info["visib_fract"] <= 1
        depth = cv2.imread(str(scene / "depth/000003.png"), -1) * cameras["3"]["depth_scale"]
        assert depth[truth.part_mask(3) > 0] == pytest.approx(1000)
    models = json.loads((tmp_path / "bop/models/models_info.json").read_text())
    assert models["1"]["diameter"] == pytest.approx(1000 * np.linalg.norm([0.4, 0.3, 0.1]))
    assert models["1"]["size_x"] == pytest.approx(400) and models["1"]["min_z"] == pytest.approx(-50)


def test_a_silhouette_is_where_the_part_projects():
    truth = truths()["a"]
    camera = Camera.from_fov(320, 256, 0.6)
    mesh, T = truth.articulation.reference, truth.Ts_camera_reference[0]
    inside = silhouette(mesh, T, camera)
    points = se3.transform(T, mesh.vertices)
    at = (points @ camera.K.T)[:, :2] / points[:, 2:]
    hull = cv2.convexHull(at.astype(np.float32)).reshape(-1, 2)  # of a box it is the silhouette
    area = cv2.contourArea(hull)
    assert inside.sum() == pytest.approx(area, rel=0.01)
    assert not silhouette(mesh, se3.pose(np.eye(3), [0, 0, -2.0]), camera).any()  # behind the camera
