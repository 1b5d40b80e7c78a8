"""Prescribed motion is judged by its drive force; stiction bounds are reported. 45 s."""

from __future__ import annotations

from pathlib import Path

import pytest
from gap_case import asset_of
from steady_case import steady_of

from benchmarks.real_recordings import recordings
from freeart21.asset import Asset
from freeart21.files.asset import read_asset
from freeart21.files.measured import read_measured
from freeart21.measured import Measured
from simgap.fit.force_search import list_candidates
from simgap.fit.problem import make_problem
from simgap.measure.data import make_fit_runs
from simgap.measure.prescribed import make_force_runs
from simgap.models.surrogate import make_plant
from simgap.select.split import split_runs
from simgap.workflow import find_gap, make_force_problem

REAL = [name for name in ("directdrive_steady", "directdrive_breakaway") if name in recordings()]


@pytest.fixture(scope="module")
def asset(tmp_path_factory) -> Asset:
    return read_asset(asset_of(tmp_path_factory.mktemp("asset")))


def test_stribeck_friction_is_found_from_steady_torque(asset: Asset):
    found = find_gap(asset, steady_of(1, dry=0.8, rise=0.5, curve=0.03))
    assert (found.verdict, found.by, found.in_part) == ("named", "force", False)
    (friction,) = found.effects
    assert friction.effect.name == "stribeck_friction"
    assert friction.effect.values() == pytest.approx((0.8, 0.5, 0.03), rel=0.1)
    assert all(friction.low[n] <= x <= friction.high[n] for n, x in zip(friction.low, (0.8, 0.5, 0.03), strict=True))
    assert "torque" in found.sentence and "kept to confirm it" in found.sentence
    assert any("SAPIEN has not confirmed it" in note for note in found.notes)
    confirming = [gap for gap in found.gaps if gap.use == "confirming"]
    assert len(confirming) == 4 or len(confirming) == 5
    assert all(gap.after < 0.1 * gap.before for gap in confirming)


def test_constant_load_confounds_dry_and_load_friction(asset: Asset):
    found = find_gap(asset, steady_of(0, dry=0.6, speeds=(0.02, 0.05, 0.1, 0.2, 0.4, 0.8)))
    assert found.verdict == "ambiguous"
    assert set(found.rivals) == {("coulomb_friction",), ("load_friction",)}


def test_position_forces_need_both_directions(asset: Asset):
    def names(measured: Measured) -> set[str]:
        plant = make_plant(asset, measured)
        seen = make_force_runs(measured, plant)
        assert seen is not None
        problem = make_problem(plant, measured, *make_fit_runs(measured, plant))
        return set(list_candidates(make_force_problem(problem, seen[0]), split_runs(seen[0]).train_runs))

    of_place = {"detent", "return_spring", "gravity_offset", "actuator_gain"}
    both, one = names(steady_of(0, dry=0.6)), names(steady_of(0, dry=0.6, one_way=True))
    assert of_place <= both and not of_place & one
    assert {"coulomb_friction", "stribeck_friction", "viscous_damping"} <= one
    assert not both & {"load_friction", "encoder_scale", "actuator_delay", "latch", "end_stop_bounce"}


@pytest.mark.skipif(not REAL, reason="the recordings are not here")
@pytest.mark.parametrize("name", REAL)
def test_a_real_direct_drive_has_its_published_friction(name: str, tmp_path: Path):
    """11 to 14 N m at all steady speeds; breakaway at 10.75 and -12.0 N m, and none at 10 in another run."""
    recordings()[name](tmp_path)
    measured = read_measured(tmp_path / "measured")
    found = find_gap(read_asset(tmp_path / "asset.urdf", guesses=False), measured)
    if name == "directdrive_breakaway":
        assert found.verdict == "not_excited" and "held against 9.48 N m" in found.sentence
        return
    assert found.by == "force" and found.verdict == "ambiguous"
    assert set(found.rivals) == {("coulomb_friction",), ("load_friction",)}
    (friction,) = found.effects
    assert friction.low["level"] < 13.0 and friction.high["level"] > 12.0
    assert all(gap.after < 0.25 * gap.before for gap in found.gaps)
