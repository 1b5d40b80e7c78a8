"""The certificate of an exported asset, and what `check-asset` finds in assets into which a fault was planted."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from command_line import run_command
from refusal import assert_refused
from solid_case import box
from test_check_asset import REAL, files_of
from test_export import reconstruction

from export.check.consistency_rules import RULES as CONSISTENCY_RULES
from export.check.consistency_rules import judge_consistency
from export.check.subject import find_subject
from export.contact import read_link_shapes
from export.exporter import export_result
from export.settings import ExportSettings, MeshSettings, PlacementSettings
from freeart21.articulation import Articulation
from freeart21.files.certificate import FILE, read_certificate
from freeart21.joint import Joint
from freeart21.mesh import Mesh
from freeart21.reconstruction import Trust

SETTINGS = ExportSettings(material="wood", placement=PlacementSettings(up=(0.0, 0.0, 1.0)))
FAILING = REAL / "failing" / "asset"


def drawer(depth: float = 0.0):
    """A base with a drawer that slides along y in front of it, `depth` m into it when closed."""
    joint = Joint("slide", "prismatic", np.array([0.0, -1.0, 0.0]), np.zeros(3), 0.0, 0.1)
    base = box((0.2, 0.15, 0.1), (0, 0, 0.05), (150, 90, 40))
    front = box((0.16, 0.06, 0.06), (0, -0.075 - 0.0305 + depth, 0.05), (20, 40, 220))
    return reconstruction("prismatic", (0.0, 0.05, 0.1), **vars(Articulation(joint, base, front)))


@pytest.fixture(scope="module")
def exported(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("assets") / "drawer"
    export_result(drawer(), out, SETTINGS)
    return out


@pytest.fixture
def asset(exported: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(exported, tmp_path / "asset"))


def failed(folder: Path) -> dict[str, str]:
    return {row.rule: row.reason for row in files_of(folder) if row.verdict == "fail"}


def test_a_good_asset_passes_and_its_certificate_says_what_its_files_give(exported: Path):
    assert failed(exported) == {}
    certificate = read_certificate(exported)
    base = certificate.links["reference"]
    assert base.seen_share == 1 and base.supposed == {}
    assert base.contact["worst_m"] < 1e-3
    assert certificate.visual_overlap_m == 0 and certificate.contact_overlap_m < 5e-4
    assert base.mass_kg == pytest.approx(700 * 0.2 * 0.15 * 0.1, rel=1e-3)
    area = 2 * (0.2 * 0.15 + 0.2 * 0.1 + 0.15 * 0.1)
    assert base.mass_low_kg == pytest.approx(700 * area * 1e-3, rel=1e-3)
    assert base.mass_high_kg == pytest.approx(base.mass_kg, rel=1e-3)
    assert (base.mass, base.material, certificate.trust) == ("given material", "wood", "not stated")
    assert certificate.engines["sapien"].verdict == "reloaded"


def test_an_open_part_says_how_much_of_it_was_seen_and_how_the_rest_was_supplied(tmp_path: Path):
    answer = reconstruction()
    lid = answer.articulation.moving
    up = lid.vertices[lid.faces][:, :, 2].min(1) > lid.vertices[:, 2].max() - 1e-9
    open_lid = Mesh(lid.vertices, lid.faces[~up], lid.colours)
    export_result(reconstruction(moving=open_lid), tmp_path / "lid", ExportSettings(meshes=MeshSettings(points=4_000)))
    link = read_certificate(tmp_path / "lid").links["moving"]
    top = 0.2 * 0.15 / (2 * 0.2 * 0.15 + 2 * 0.03 * (0.2 + 0.15))
    assert link.seen_share == pytest.approx(1 - top, abs=0.02)
    assert sum(link.supposed.values()) == pytest.approx(top, abs=0.02) and set(link.supposed) == {"closing surface"}


def test_check_asset_writes_its_trials_into_the_certificate(asset: Path, capsys):
    assert run_command(capsys, "check-asset", asset, "--engines", "sapien", "--certify")[0] == 0
    engines = read_certificate(asset).engines
    assert set(engines) == {"file", "sapien"} and engines["sapien"].verdict == "pass"
    assert failed(asset) == {}


def test_a_certificate_that_is_none_costs_one_line(asset: Path):
    (asset / FILE).write_text('{"schema": "freeart21/certificate/1", "links": 3}')
    assert "expected" in failed(asset)["certificate.same"]
    assert_refused("certificate.json", read_certificate, asset)


# ---- planted faults


def edit(file: str, old: str, new: str, count: int = 1) -> Callable[[Path], None]:
    """A regular expression replaced in a file of the asset."""

    def plant(folder: Path) -> None:
        text = (folder / file).read_text()
        changed = re.sub(old, new, text, count=count)
        assert changed != text
        (folder / file).write_text(changed)

    return plant


def moved(file: str, offset: tuple[float, float, float]) -> Callable[[Path], None]:
    """The vertices of an OBJ file moved by `offset`, m."""

    def plant(folder: Path) -> None:
        lines = []
        for line in (folder / file).read_text().splitlines():
            if line.startswith("v "):
                x = np.array(line.split()[1:4], float) + offset
                line = "v " + " ".join(repr(float(value)) for value in x)
            lines.append(line)
        (folder / file).write_text("\n".join(lines) + "\n")

    return plant


PLANTED: dict[str, tuple[str, Callable[[Path], None]]] = {
    "a picture is 3 mm in the base": ("parts.visuals-clear", moved("meshes/moving.obj", (-0.0035, 0, 0))),
    "a picture beside its contact": ("collision.matches-visual", moved("meshes/reference.obj", (0, 0.04, 0))),
    "a mass in the MJCF alone": ("mjcf.same", edit("object.xml", r'mass="(0|[1-9])\.', r'mass="9\1.')),
    "an axis turned in the MJCF alone": ("mjcf.same", edit("object.xml", r'axis="[^"]+"', 'axis="0 1 0"')),
    "limits of the MJCF alone": ("mjcf.same", edit("object.xml", r' range="[^"]+"', ' range="0 0.2"')),
    "a contact shape lost in the MJCF": ("mjcf.same", edit("object.xml", r'<geom type="box"[^>]*/>', "")),
    "a body renamed in the MJCF": ("mjcf.same", edit("object.xml", 'body name="moving"', 'body name="front"')),
    "a joint of another type in the MJCF": ("mjcf.same", edit("object.xml", 'type="slide"', 'type="hinge"')),
    "the loaders' friction is another": (
        "loaders.same", edit("loaders/joint.json", r'"friction": [^,]+', '"friction": 5.0'),
    ),
    "a certificate of less overlap": (
        "certificate.same", edit(FILE, '"visual_overlap_m": [^,]+', '"visual_overlap_m": 0.02'),
    ),
    "a certificate of more trust": ("certificate.same", edit(FILE, '"trust": "[^"]+"', '"trust": "sound"')),
    "a certificate of another mass": ("certificate.same", edit(FILE, '"mass_kg": [^,]+', '"mass_kg": 1.0')),
    "a certificate of more seen": ("certificate.same", edit(FILE, '"seen_share": [^,]+', '"seen_share": 0.5')),
    "a certificate of other links": ("certificate.same", edit(FILE, '"moving": {', '"front": {')),
    "a certificate of better contact": (
        "collision.true-to-visual", edit(FILE, '"worst_m": [^,]+', '"worst_m": 0.05'),
    ),
}  # fmt: skip
"""Faults of an asset's files against each other; those of a URDF alone are in test_check_asset."""


@pytest.mark.parametrize("fault", PLANTED)
def test_each_planted_fault_fails_its_rule(asset: Path, fault: str):
    rule, plant = PLANTED[fault]
    plant(asset)
    if rule in CONSISTENCY_RULES:  # the others take seconds
        subject = find_subject(asset)
        rows = judge_consistency(subject.urdf, read_link_shapes(subject.urdf)[0])
        assert rule in [row.rule for row in rows if row.verdict == "fail"]
    else:
        assert rule in failed(asset)


@pytest.mark.parametrize("carve", [True, False])
def test_parts_in_each_other_are_found_in_what_export_writes(tmp_path: Path, carve: bool):
    """The parts of the answer itself overlap by 3 mm: `export` carves them, or its files say so."""
    settings = replace(SETTINGS, placement=replace(SETTINGS.placement, carve=carve))
    answer = replace(drawer(0.0035), trust=Trust("doubtful", ("the axis wavers",)))
    export_result(answer, tmp_path / "asset", settings)
    certificate = read_certificate(tmp_path / "asset")
    assert (certificate.trust, certificate.reasons) == ("doubtful", ("the axis wavers",))
    overlap = certificate.visual_overlap_m
    if carve:
        assert "parts.visuals-clear" not in failed(tmp_path / "asset") and overlap < 0.001
    else:
        assert "3 mm in each other" in failed(tmp_path / "asset")["parts.visuals-clear"]
        assert overlap == pytest.approx(0.003, abs=2e-4)


HANDED = {
    "d_good.urdf": None,
    "faucet_wall.urdf": None,
    "d_visual_mm.urdf": "collision.matches-visual",
    "d_col_shift.urdf": "collision.matches-visual",
    "d_vis_shift.urdf": "collision.matches-visual",
    "d_into_body.urdf": "parts.clear",
    "35_mm_inertia": "inertia.fits-shape",
}


@pytest.mark.skipif(not FAILING.is_dir(), reason="shared/failing is not at hand")
@pytest.mark.parametrize("name", HANDED)
def test_every_fault_that_was_handed_in_is_found(name: str):
    found = failed(FAILING / name)
    assert HANDED[name] in found if HANDED[name] else found == {}


@pytest.mark.skipif(not FAILING.is_dir(), reason="shared/failing is not at hand")
def test_a_template_is_refused():
    assert_refused("xacro", find_subject, FAILING / "xacro.urdf")
