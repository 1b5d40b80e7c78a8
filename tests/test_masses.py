"""Masses and materials a part, and friction and restitution as engines read them back."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
from command_line import run_command
from engine_case import loader
from refusal import assert_refused
from solid_case import box
from test_export import masses, reconstruction

from export import exporter
from export.exporter import export_result
from export.masses import weigh_parts
from export.materials import DENSITIES, TABLE
from export.parts import close_parts
from export.settings import ExportSettings
from freeart21.articulation import PARTS
from freeart21.files.asset import read_asset
from freeart21.files.certificate import read_certificate
from freeart21.files.result import write_result
from freeart21.mesh import bounding_diagonal

SOLIDS = {"reference": box((0.2, 0.15, 0.04)), "moving": box((0.2, 0.15, 0.03))}
VOLUMES = {"reference": 0.2 * 0.15 * 0.04, "moving": 0.2 * 0.15 * 0.03}
LINKS = {"reference": "base", "moving": "lid"}
STEEL, RUBBER = TABLE["steel"], TABLE["rubber"]


def weighed(**settings) -> dict:
    return weigh_parts(SOLIDS, LINKS, **settings)


def kilograms(**settings) -> list[float]:
    return [part.density * VOLUMES[name] for name, part in weighed(**settings).items()]


def test_masses_are_given_by_the_name_of_a_link_or_a_part():
    assert kilograms(mass={"base": 2.2, "lid": 0.5}) == pytest.approx([2.2, 0.5])
    assert kilograms(mass={"moving": 0.5}) == pytest.approx([1050 * VOLUMES["reference"], 0.5])
    found = weighed(mass={"lid": 0.5})
    assert found["moving"].bounds_kg == (0.5, 0.5) and (found["moving"].by, found["moving"].guessed) == ("mass", False)
    assert found["reference"].guessed


def test_materials_are_given_for_all_or_by_part():
    assert kilograms(material="wood") == pytest.approx([700 * v for v in VOLUMES.values()])
    found = weighed(material={"base": "steel"})
    assert [part.material for part in found.values()] == ["steel", "plastic"]
    assert [part.guessed for part in found.values()] == [False, True]


@pytest.mark.parametrize(("rims", "closed"), [(False, 2), (True, 1)])
def test_unseen_walls_are_those_of_the_material_that_a_role_names(tmp_path, monkeypatch, rims, closed):
    """Roles are known once the parts are whole: where a thickness is a usual one, they are closed again."""
    walls_given = []

    def close(*given):
        walls_given.append(given[-1])
        whole = close_parts(*given)
        found = {"thickness_by": "rims" if rims else "size and material"}
        return replace(whole, parts={name: replace(part, panels=found) for name, part in whole.parts.items()})

    monkeypatch.setattr(exporter, "close_parts", close)
    answer = reconstruction()
    sizes = [bounding_diagonal(answer.articulation.part(name)) for name in PARTS]
    asset = export_result(answer, tmp_path / "a", ExportSettings(material={"door": "wood"}, scale=2.0))
    assert asset.source["parts"]["moving"]["role"] == "door"
    assert len(walls_given) == closed
    materials = ("plastic", "plastic" if rims else "wood")
    usual = [TABLE[name].usual_wall(2 * size) / 2 for name, size in zip(materials, sizes, strict=True)]
    assert list(walls_given[-1].values()) == pytest.approx(usual)


def test_a_mass_of_the_whole_is_divided_by_volume_and_density():
    heavy = kilograms(mass=2.0, material={"base": "steel", "lid": "wood"})
    assert sum(heavy) == pytest.approx(2)
    assert heavy[0] / heavy[1] == pytest.approx(7850 * 4 / (700 * 3))
    found = weighed(mass=2.0)
    for name, part in found.items():
        low, high = part.bounds_kg
        assert 0 < low < part.density * VOLUMES[name] < high < 2
    (low, _), (_, high) = (part.bounds_kg for part in found.values())
    assert low + high == pytest.approx(2)


def test_bounds_are_of_a_shell_and_of_a_solid_and_of_any_material_where_none_was_given():
    area = 2 * (0.2 * 0.15 + 0.2 * 0.04 + 0.15 * 0.04)
    assert weighed(material="steel")["reference"].bounds_kg == pytest.approx((7850e-3 * area, 7850 * 0.2 * 0.15 * 0.04))
    low, high = weighed()["reference"].bounds_kg
    assert low == pytest.approx(min(DENSITIES.values()) * 1e-3 * area)
    assert high == pytest.approx(7850 * VOLUMES["reference"])
    sheet = weighed(density=1000.0, wall=0.002)["reference"].bounds_kg
    assert sheet == pytest.approx((2 * area, 2 * area))


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"mass": {"door": 1.0}}, "mass of 'door': there is no such part; parts: base, lid, reference, moving"),
        ({"material": {"bsae": "wood"}}, "material of 'bsae'"),
    ],
)
def test_a_name_that_is_no_part_is_refused(settings: dict, message: str):
    assert_refused(message, weigh_parts, SOLIDS, LINKS, **settings)


@pytest.mark.parametrize(
    "words, message",
    [
        (["--material", "base=lead"], "there is no material 'lead'"),
        (["--mass", "two"], "--mass has 'two', expected kg"),
        (["--mass", "1", "2"], "expected one value, or NAME=VALUE"),
        (["--mass", "reference=-1"], "mass is -1 kg"),
    ],
)
def test_words_that_say_nothing_cost_one_line(tmp_path: Path, capsys, words: list[str], message: str):
    write_result(tmp_path / "ours/s1", reconstruction())
    (tmp_path / "ours/method.json").write_text('{"schema": "freeart21/method/1", "name": "ours"}')
    code, _, error = run_command(capsys, "export", tmp_path / "ours/s1", "--out", tmp_path / "a", *words)
    assert code == 1 and message in error and error.count("\n") == 1


@pytest.fixture(scope="module")
def asset(tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("assets") / "lid"
    settings = ExportSettings(material={"reference": "steel", "moving": "rubber"}, mass={"moving": 0.4}, usd=None)
    export_result(reconstruction(), out, settings)
    return out


def names(folder: Path) -> tuple[str, str]:
    found = read_asset(folder)
    return found.reference_link, found.moving_link


def test_the_certificate_says_where_masses_come_from(asset: Path):
    links = read_certificate(asset).links
    base, lid = (links[name] for name in names(asset))
    assert (base.mass, base.material, lid.mass, lid.material) == ("given material", "steel", "given mass", "rubber")
    assert masses(asset)[names(asset)[1]] == pytest.approx(0.4, rel=1e-5)


def test_sapien_has_the_friction_and_restitution_of_each_material(asset: Path):
    import sapien

    scene = sapien.Scene([sapien.physx.PhysxCpuSystem()])
    scene.set_timestep(0.002)
    articulation = loader(asset, "sapien").load(scene)
    for name, of in zip(names(asset), (STEEL, RUBBER), strict=True):
        link = next(link for link in articulation.links if link.name == name)
        for shape in link.collision_shapes:
            material = shape.physical_material
            found = (material.static_friction, material.dynamic_friction, material.restitution)
            assert found == pytest.approx((of.friction, of.friction, of.restitution))


def test_mujoco_has_the_friction_of_each_material(asset: Path):
    import mujoco

    model = mujoco.MjModel.from_xml_path(str(asset / "object.xml"))
    for name, of in zip(names(asset), (STEEL, RUBBER), strict=True):
        geoms = [k for k in range(model.ngeom) if model.geom_bodyid[k] == model.body(name).id and model.geom_contype[k]]
        assert geoms and all(model.geom_friction[k][0] == pytest.approx(of.friction) for k in geoms)


def test_pybullet_has_the_friction_and_restitution_of_each_material(asset: Path):
    pybullet = pytest.importorskip("pybullet")
    client = pybullet.connect(pybullet.DIRECT)
    try:
        body = loader(asset, "pybullet").load(client=client)
        found = {pybullet.getBodyInfo(body, physicsClientId=client)[0].decode(): -1}
        found |= {pybullet.getJointInfo(body, 0, physicsClientId=client)[12].decode(): 0}
        for name, of in zip(names(asset), (STEEL, RUBBER), strict=True):
            info = pybullet.getDynamicsInfo(body, found[name], physicsClientId=client)
            assert (info[1], info[5]) == pytest.approx((of.friction, of.restitution))
    finally:
        pybullet.disconnect(client)


def test_usd_has_the_friction_and_restitution_of_each_material(asset: Path):
    pytest.importorskip("pxr")
    from pxr import Usd, UsdPhysics, UsdShade

    stage = Usd.Stage.Open(str(asset / "object.usdc"))
    seen = 0
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.CollisionAPI):
            bound = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial("physics")[0]
            physics = UsdPhysics.MaterialAPI(bound.GetPrim())
            of = STEEL if str(prim.GetPath().GetParentPath().name) == names(asset)[0] else RUBBER
            found = (physics.GetStaticFrictionAttr().Get(), physics.GetRestitutionAttr().Get())
            assert found == pytest.approx((of.friction, of.restitution))
            seen += 1
    assert seen >= 2
