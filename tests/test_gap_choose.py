"""What is named, what is left open, and what is refused: on motions from equations that the product does not have."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from gap_case import INERTIA, asset_of, measured_of

from freeart21.effects import Effect
from freeart21.effects.actuator_delay import ActuatorDelay
from freeart21.effects.coulomb_friction import CoulombFriction
from freeart21.effects.detent import Detent
from freeart21.effects.gravity_offset import GravityOffset
from freeart21.effects.return_spring import ReturnSpring
from freeart21.effects.stribeck_friction import StribeckFriction
from freeart21.errors import FreeArtError
from freeart21.files.asset import read_asset
from freeart21.measured import Measured
from simgap.fitting import search as search_module
from simgap.fitting.fit import Fit, Theory, fitted
from simgap.fitting.search import Search, caught, relaxed
from simgap.judgement import choose, intervals, objections
from simgap.judgement.choose import earned, last, rivals
from simgap.judgement.judge import Judged, folds_of, p_value
from simgap.measure.data import FitRun, fit_runs
from simgap.motion.surrogate import plant_of
from simgap.settings import ChoiceSettings, GapSettings
from simgap.verdict import Verdict
from simgap.workflow import find_gap, problem_of


def verdict(folder: Path, measured: Measured, lower: float = -3.0, upper: float = 3.0) -> Verdict:
    return find_gap(read_asset(asset_of(folder, lower, upper), "j"), measured)


@pytest.fixture(scope="module")
def damped(tmp_path_factory: pytest.TempPathFactory) -> Verdict:
    """On runs with a loss that goes almost with speed."""
    return verdict(tmp_path_factory.mktemp("damped"), measured_of(11, viscous=0.12, power=0.9))


def search_on(folder: Path, measured: Measured, upper: float = 3.0) -> Search:
    """Over no effects, on the first three runs."""
    plant = plant_of(read_asset(asset_of(folder, upper=upper), "j"), measured)
    runs, floor = fit_runs(measured, plant)
    return Search(problem_of(plant, measured, runs, floor, GapSettings()), runs[:3], ChoiceSettings(), ())


def names(found: Verdict) -> set[str]:
    return {named.effect.name for named in found.effects}


@pytest.mark.parametrize("seed, servo", [(0, False), (1, True)])
def test_nothing_is_found_where_nothing_is_missing(tmp_path: Path, seed: int, servo: bool):
    found = verdict(tmp_path, measured_of(seed, servo=servo))
    assert found.verdict == "no_gap" and not found.effects and not found.rivals
    assert all(gap.before < 1.3 * gap.floor for gap in found.gaps)


@pytest.mark.parametrize(
    "hidden, expected",
    [
        ({"dry": 0.15}, "coulomb_friction"),
        ({"drag": 0.06}, "quadratic_drag"),
        ({"spring": 2.0, "rest": 0.3}, "return_spring"),
        ({"viscous": 10.0}, "viscous_damping"),  # its speed is gone in a 24th of a second, and it creeps
        ({"viscous": 100.0}, "viscous_damping"),  # and in a 240th
    ],
)
def test_a_clear_effect_is_named(tmp_path: Path, hidden: dict[str, float], expected: str):
    agrees(verdict(tmp_path, measured_of(11, **hidden)), expected)


def test_a_loss_is_named_and_written_as_it_stands(damped: Verdict, tmp_path: Path):
    agrees(damped, "viscous_damping")
    damped.write(tmp_path / "verdict.json", "revolute")
    said = json.loads((tmp_path / "verdict.json").read_text())
    assert said["verdict"] == "named" and said["effects"][0]["name"] == "viscous_damping"
    coefficient = said["effects"][0]["parameters"]["coefficient"]
    assert coefficient["unit"] == "N*m*s/rad" and coefficient["low"] < coefficient["value"] < coefficient["high"]
    assert [gap["held_out"] for gap in said["gap"]] == [False] * 3 + [True] * 2


def agrees(found: Verdict, expected: str) -> None:
    assert (found.verdict, names(found)) == ("named", {expected})
    held = [gap for gap in found.gaps if gap.held_out]
    assert len(held) == 2 and all(gap.after < 0.2 * gap.before for gap in held)
    low, high = found.effects[0].low, found.effects[0].high
    assert all(low[k] <= getattr(found.effects[0].effect, k) <= high[k] for k in low)


def test_bouncing_off_a_stop_is_named(tmp_path: Path):
    measured = measured_of(12, lower=-0.5, upper=1.6, bounce=0.6)
    found = verdict(tmp_path, measured, -0.5, 1.6)
    assert (found.verdict, names(found)) == ("named", {"end_stop_bounce"})
    assert found.effects[0].effect.restitution == pytest.approx(0.6, abs=0.03)


def test_a_pair_is_named_that_no_single_effect_is_part_of(tmp_path: Path):
    """Dry friction with drag looks like oil on the whole: one step at a time would name that."""
    found = verdict(tmp_path, measured_of(13, dry=0.1, drag=0.05))
    assert (found.verdict, names(found)) == ("named", {"coulomb_friction", "quadratic_drag"})


def test_friction_with_oil_is_no_friction_under_load(tmp_path: Path):
    """Load goes with speed squared on a swing: beside a gap of 300 floors that form would do for a little oil.

    Of five draws (23 to 27) four are told; 24 is called load friction on some processors and not on others.
    """
    found = verdict(tmp_path, measured_of(23, dry=0.5, viscous=0.1))
    assert (found.verdict, names(found)) == ("named", {"coulomb_friction", "viscous_damping"})


def test_runs_that_hang_on_a_hair_do_not_decide(tmp_path: Path):
    """One run to fit and one held out go another way from the middle on, as if someone had bumped the table."""
    measured = measured_of(25, runs=9, viscous=0.12)
    bumped = []
    for i, run in enumerate(measured.runs):
        half = len(run.q) // 2
        q = np.concatenate([run.q[:half], 0.7 * run.q[half:] + 0.3]) if i in (1, 6) else run.q
        bumped.append(replace(run, q=q, held_out=i >= 5))
    found = verdict(tmp_path, replace(measured, runs=tuple(bumped)))
    assert (found.verdict, names(found)) == ("named", {"viscous_damping"})
    whole = verdict(
        tmp_path, replace(measured, runs=tuple(replace(run, held_out=i >= 5) for i, run in enumerate(measured.runs)))
    )
    assert found.effects[0].effect.coefficient == pytest.approx(whole.effects[0].effect.coefficient, rel=0.05)


def test_a_zero_that_is_off_may_be_a_leaning_base(tmp_path: Path):
    found = verdict(tmp_path, measured_of(14, offset=0.15))
    assert found.verdict == "ambiguous"
    assert {("encoder_offset",), ("gravity_offset",)} <= set(found.rivals)
    assert found.next_experiment and "the explanations then differ by" in found.next_experiment


def test_a_heavier_drive_may_be_a_weaker_pull(tmp_path: Path):
    """Half as much inertia again swings as under two thirds of the weight, where no other force is known."""
    found = verdict(tmp_path, measured_of(27, inertia=1.5 * INERTIA))
    assert found.verdict == "ambiguous" and {("armature",), ("gravity_offset",)} <= set(found.rivals)


def test_a_late_drive_may_be_a_late_clock(tmp_path: Path):
    found = verdict(tmp_path, measured_of(15, servo=True, delay=0.03))
    assert found.verdict == "ambiguous" and {("actuator_delay",), ("time_offset",)} <= set(found.rivals)


@pytest.mark.parametrize("strange", [{"cog": 0.4, "count": 7.0}])
def test_what_is_in_no_library_has_no_name(tmp_path: Path, strange: dict[str, float]):
    found = verdict(tmp_path, measured_of(16, **strange))
    assert found.verdict == "unexplained" and not found.effects


@pytest.mark.parametrize("hardens", [0.15, 0.3])
def test_what_hardens_as_no_spring_does_is_none(tmp_path: Path, hardens: float):
    found = verdict(tmp_path, measured_of(11, spring=2.0, rest=0.3, hardens=hardens))
    assert found.verdict == "unexplained" and not found.effects


@pytest.mark.parametrize("rest, one_way", [(-1.0, False), (0.3, False), (1.6, False), (2.9, True), (-9.0, True)])
def test_a_spring_that_pulls_alike_everywhere_may_be_friction_that_differs_by_direction(
    tmp_path: Path, rest: float, one_way: bool
):
    problem = replace(search_on(tmp_path, measured_of(11)).problem, q_low=-1.4, q_high=1.4)
    for effects, told in (
        ((CoulombFriction(0.1), ReturnSpring(0.1, rest)), one_way),
        ((ReturnSpring(0.1, rest),), False),
    ):
        fit = SimpleNamespace(effects=effects, theory=SimpleNamespace(problem=problem))
        assert objections.may_be_one_way(SimpleNamespace(fit=fit)) is told


def test_a_force_that_first_guesses_miss_is_fitted_all_the_same(tmp_path: Path):
    """A door that friction holds for most of the time tells nothing, to first order, of what would have moved it."""
    search = replace(search_on(tmp_path, measured_of(11, lean=0.3)), names=("detent", "gravity_offset"))
    cut, at, found = search._guesses()
    search._first = cut, at, [guess for guess in found if guess.name == "detent"]
    best = search.singles()[0]
    assert best.theory.names == ("gravity_offset",) and best.level < 1.2


def test_an_effect_that_is_left_out_of_the_library_is_not_named(tmp_path: Path):
    asset, measured = read_asset(asset_of(tmp_path), "j"), measured_of(11, spring=2.0, rest=0.3)
    found = find_gap(asset, measured, GapSettings(without=("return_spring",)))
    assert found.verdict != "no_gap"
    assert "return_spring" not in names(found) | {name for names in found.rivals for name in names}


@pytest.mark.parametrize(
    "effect, nothing",
    [
        (CoulombFriction(0.0), True),
        (GravityOffset(constant=0.1), False),
        (StribeckFriction(0.0, 0.1, 0.2), False),
        (Detent(0.0, 0.3, 0.1), True),
        (ActuatorDelay(0.0), False),
    ],
)
def test_an_effect_without_size_is_nothing(effect: Effect, nothing: bool):
    assert objections._is_nothing(effect) == nothing


def _run_by_run(**floors: float) -> dict[str, np.ndarray]:
    return {run: np.full(50, level) for run, level in floors.items()}


@pytest.mark.parametrize(
    "after, enough",
    [
        ((3.0, 1.2, 4.0), True),  # one of three may hang on a hair
        ((1.5, 8.0, 4.0), False),
        ((1.0, 1.0, 1.0), True),
        ((1.0,) * 9 + (9.0,) * 2, True),  # two of eleven
        ((1.0,) * 9 + (9.0,) * 3, False),  # a quarter
        ((1.0, 9.0), False),
    ],
)
def test_what_helps_few_of_the_runs_with_a_gap_explains_nothing(after: tuple[float, ...], enough: bool):
    """The first run was fitted, the others held out; `quiet` has no gap that could close."""
    names = [f"r{i}" for i in range(len(after))]
    fitted = _run_by_run(r0=9.0)
    before = Judged(SimpleNamespace(residuals=fitted), _run_by_run(quiet=1.1, **dict.fromkeys(names[1:], 5.0)))
    left = _run_by_run(quiet=1.1, **dict(zip(names[1:], after[1:], strict=True)))
    found = Judged(SimpleNamespace(residuals=_run_by_run(r0=after[0])), left)
    assert objections.helps(found, before, ChoiceSettings()) == enough
    assert objections.helps(found, found, ChoiceSettings(plain_gap=99.0))


@pytest.mark.parametrize(
    "fitted, held, usual, enough",
    [(25.0, 60.0, 9.0, False), (25.0, 10.0, 9.0, True), (10.0, 60.0, 9.0, True), (25.0, 60.0, 15.0, True)],
)
def test_what_has_nearly_all_of_the_gap_is_spared_once(fitted: float, held: float, usual: float, enough: bool):
    """Of fitted or of held-out runs: a motion that is missed wherever it comes hangs on no hair."""
    others = {f"r{i}": usual for i in range(3)}
    far = _run_by_run(far=60.0, h1=usual, h2=usual)
    before = Judged(SimpleNamespace(residuals=_run_by_run(wide=60.0, **others)), far)
    after = Judged(
        SimpleNamespace(residuals=_run_by_run(wide=fitted, **dict.fromkeys(others, 1.0))),
        _run_by_run(far=held, h1=1.0, h2=1.0),
    )
    assert objections.helps(after, before, ChoiceSettings()) == enough


@pytest.mark.parametrize(
    "effects, where, bound",
    [
        (("armature",), {("shaft form", "rebound"): 0.2}, False),
        (("armature",), {("shaft form", "rebound"): 1.0}, True),  # that is no shaft, but a spring
        (("armature",), {("shaft form", "swing"): 1.0}, True),  # nor is what swings as slowly as a belt
        (("armature", "end_stop_bounce"), {("end_stop_bounce", "restitution"): 0.6}, False),
        (("armature", "end_stop_bounce"), {("end_stop_bounce", "restitution"): 0.01}, True),  # a lossless shaft's, too
        (("backlash",), {("backlash", "width"): 0.05, ("shaft form", "rebound"): 0.1}, False),
        (("backlash",), {("backlash", "width"): 0.0, ("shaft form", "rebound"): 0.1}, True),  # a twisting shaft
    ],
)
def test_what_throws_back_as_no_shaft_does_is_no_drive(tmp_path: Path, effects, where, bound: bool):
    search = search_on(tmp_path, measured_of(12, servo=True), 0.3)
    theory = Theory(search.problem, effects)
    theta = np.array([np.clip(where.get((r.owner, r.name), x), r.lower, r.upper)
                      for r, x in zip(theory.ranges(), theory.neutral(), strict=True)])  # fmt: skip
    fit = replace(search.base(), theory=theory, theta=theta)
    assert objections.at_bound(fit) is bound
    if effects == ("armature",):
        (armature,) = fit.effects
        share = armature.value / (search.problem.plant.mechanics.inertia + armature.value)
        z = search.problem.fit.shaft_damping * np.sqrt(1 - share)  # of the drive's inertia alone
        swing = np.sqrt(1 - z * z)
        lasting = np.exp(-2 * z * np.arctan2(swing, z) / swing)
        back, swing = (where.get(("shaft form", name), 0.5) for name in ("rebound", "swing"))
        assert armature.throw_back == pytest.approx(back * lasting)
        slowest = search.problem.fit.swing_tolerance * search.problem.crossing_s  # of both about the shaft
        assert armature.swing == pytest.approx(swing * slowest / np.sqrt(1 - share))


@pytest.mark.parametrize(
    "plain, free, worse, strained",
    [
        ({"inertia": "upper", "gravity": "upper"}, None, 1.5, True),
        ({"inertia": "upper", "gravity": "upper"}, None, 1.05, False),  # as well without: a gauge
        ({"inertia": "upper", "lean_1": "lower"}, {"inertia": "upper", "lean_1": "lower", "gravity": "upper"}, 2, True),
        ({"inertia": "upper", "gravity": "upper"}, {"inertia": "upper"}, 2, False),  # that is the formula's doing
        ({"inertia": "upper"}, None, 2, False),
        ({}, {"inertia": "upper", "gravity": "upper"}, 2, False),
    ],
)
def test_what_needs_an_asset_that_is_off_in_every_way_has_no_name(
    tmp_path: Path, monkeypatch, plain, free, worse: float, strained: bool
):
    search = search_on(tmp_path, measured_of(12), 0.3)
    theory = Theory(search.problem, ("viscous_damping",))

    def fit_at(ends: dict[str, str]) -> Fit:
        values = [getattr(r, ends[r.name]) if r.name in ends else x
                  for r, x in zip(theory.ranges(), theory.neutral(), strict=True)]  # fmt: skip
        return replace(search.base(), theory=theory, theta=np.array(values))

    def half_way(fit: Fit, held: Fit, runs) -> Fit:
        for r, x, end in zip(theory.ranges(), held.theta, fit.theta, strict=True):
            assert x == (pytest.approx(0.5 * (end + r.neutral)) if r.owner == "asset" else end)
        return replace(fit, cost=worse * fit.cost)

    monkeypatch.setattr(objections, "beside", half_way)
    judgement = Judged(fit_at(plain), {}, free=None if free is None else fit_at(free))
    assert objections.strained(judgement, search) is strained


def test_what_a_drive_has_of_its_shaft_is_as_sure_as_what_was_fitted(tmp_path: Path):
    search = search_on(tmp_path, measured_of(12, servo=True), 0.3)
    theory = Theory(search.problem, ("armature",))
    at = {r.name: i for i, r in enumerate(theory.ranges())}
    errors = {("shaft form", "rebound"): 0.05, ("shaft form", "swing"): 0.5}
    for rebound in (0.0, 0.4):
        theta = theory.neutral()
        theta[at["rebound"]] = rebound
        fit = replace(search.base(), theory=theory, theta=theta)
        (armature,) = fit.effects
        low, high = intervals._of_shaft(fit, errors, armature, "rebound")
        assert low <= armature.throw_back < high and (low > 0) == (rebound > 0)
        low, high = intervals._of_shaft(fit, errors, armature, "swing")
        assert low == 0.0 and high == pytest.approx(2 * armature.swing)  # from one end of what may be to the other
    assert intervals._of_shaft(search.base(), errors, armature, "swing") == (0.0, 0.0)


def test_a_drive_is_tried_with_other_parts_of_the_same_inertia(tmp_path: Path):
    """Else a fit stays where the part is too heavy, its drive too light, and nothing that comes back is right."""
    search = search_on(tmp_path, measured_of(12, servo=True), 0.3)
    theory = Theory(search.problem, ("armature",))
    own, at = search.problem.plant.mechanics.inertia, {r.name: i for i, r in enumerate(theory.ranges())}
    theta = theory.neutral()
    theta[at["inertia"]] = 1.02
    fit = replace(search.base(), theory=theory, theta=theta)
    points = np.array(search_module._shafts(fit))
    whole = points[:, at["inertia"]] * own + points[:, at["value"]]
    np.testing.assert_allclose(whole, fit.theta[at["inertia"]] * own + fit.theta[at["value"]])
    assert len(np.unique(points[:, at["inertia"]])) == 4 and len(np.unique(points[:, at["swing"]])) == 3
    assert search_module._shafts(search.base()) == []


def at(theory: Theory, **real: float) -> np.ndarray:
    """The neutral point, but for these parameters."""
    return np.array([real.get(r.name, x) for r, x in zip(theory.ranges(), theory.neutral(), strict=True)])


def told_by(truth: Fit, runs: tuple[FitRun, ...]) -> tuple[FitRun, ...]:
    """The runs with readings that a fit's own motion makes."""
    rng = np.random.default_rng(0)
    return tuple(
        replace(run, q=run.q - run.sigma * (truth.residuals[run.name] - rng.normal(size=len(run.q)))) for run in runs
    )


def test_a_shaft_that_twists_all_that_it_may_is_no_drives(tmp_path: Path):
    search = search_on(tmp_path, measured_of(12, servo=True))
    fit = search.base()
    plain, free = (Theory(search.problem, ("armature",), relaxed=it) for it in (False, True))
    most = next(r.upper for r in free.ranges() if r.name == "give")
    own = replace(fit, theory=plain, theta=at(plain))
    for part, bound in ((0.5, False), (1.0, True)):
        freed = replace(fit, theory=free, theta=at(free, give=part * most))
        assert objections.bounded(Judged(own, {}, {}, freed)) is bound
    both = Theory(search.problem, ("armature", "backlash"), relaxed=True)
    assert [r.owner for r in both.ranges() if r.name == "give"] == ["backlash form"]


@pytest.mark.parametrize("width, bends", [(0.05, False), (0.3, True)])
def test_a_notch_that_nowhere_overcomes_its_spring_is_a_bend_of_it(tmp_path: Path, width: float, bends: bool):
    search = search_on(tmp_path, measured_of(16))
    theory = Theory(search.problem, ("detent", "return_spring"))
    theta = at(theory, peak=0.5, centre=0.1, width=width, stiffness=2.0, rest=0.2)
    noise = {run.name: np.random.default_rng(0).normal(size=len(run.q)) for run in search.train}
    fit = replace(
        search.base(), theory=theory, theta=theta, residuals=noise, normal=np.diag([1e9 / x for x in theta**2 + 1e-9])
    )
    notch, spring = (next(e for e in fit.effects if e.name == name) for name in theory.names)
    q = np.linspace(-1.5, 1.5, 3001)
    falls = np.all(np.diff(notch.force(q, 0.0 * q) + spring.force(q, 0.0 * q)) < 0)
    assert bool(falls) is bends and objections.may_be_nothing(Judged(fit, noise)) is bends


def test_what_leaves_nothing_has_no_rival_that_leaves_plainly_more(tmp_path: Path):
    """Both leave little; the one is at the noise, of fitted and of held-out runs alike, and the other is not."""
    search = search_on(tmp_path, measured_of(17))
    rng = np.random.default_rng(2)

    def entry(name: str, learned: float, error: float) -> Judged:
        theory = Theory(search.problem, (name,))
        fit = replace(search.base(), theory=theory, theta=at(theory), residuals={"a": learned * rng.normal(size=2000)})
        return Judged(fit, {"b": error * rng.normal(size=2000)})

    best, settings = entry("quadratic_drag", 1.0, 1.0), ChoiceSettings()
    for learned, error, found in ((1.08, 1.14, 1), (1.0, 1.05, 2), (1.08, 1.03, 2)):
        others = rivals([entry("viscous_damping", learned, error), best], settings)
        assert others[0] is best and len(others) == found


def test_a_rival_must_help_the_runs_that_show_the_gap(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Runs that were held out show none of it: there an effect that does nothing is as good as the right one."""
    search = search_on(tmp_path, measured_of(17))

    def entry(names: tuple[str, ...], learned: float) -> Judged:
        theory = Theory(search.problem, names)
        wide = {f"r{i}": np.full(50, learned) for i in range(3)}
        fit = replace(search.base(), theory=theory, theta=at(theory), residuals=wide, cost=learned)
        return Judged(fit, {"quiet": np.full(50, 0.9)})

    base, right, idle = entry((), 9.0), entry(("latch",), 4.0), entry(("armature",), 6.0)
    larger = entry(("detent", "latch"), 1.0)
    for name in ("hollow", "bounded", "may_be_else"):
        monkeypatch.setattr(choose, name, lambda *given: False)
    monkeypatch.setattr(choose, "twins", lambda standing, *given: standing)
    monkeypatch.setattr(choose, "loosened", lambda j, folds: j)
    monkeypatch.setattr(choose, "earned", lambda *given: right)
    found = last([larger], [right, idle, larger], base, search, (), 1.35, ChoiceSettings())
    assert [j.names for j in found] == [("latch",)]


@pytest.mark.parametrize("free, kept", [(1.4, ("latch",)), (1.0, ("latch", "return_spring"))])
def test_a_member_that_does_but_what_the_form_of_the_rest_does_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, free: float, kept: tuple[str, ...]
):
    """The catch alone leaves a hair too much; with its form free as little as both together, or plainly more."""
    search = search_on(tmp_path, measured_of(17))

    def entry(names: tuple[str, ...], left: float, formed: float) -> Judged:
        theory = Theory(search.problem, names)
        fit = replace(search.base(), theory=theory, theta=at(theory))
        residuals = {f"r{i}": np.full(50, formed) for i in range(4)}
        freed = replace(fit, residuals=residuals)
        return Judged(fit, {f"h{i}": np.full(50, left) for i in range(4)}, free=freed)

    base, both, catch = entry((), 9.0, 9.0), entry(("latch", "return_spring"), 1.3, free), entry(("latch",), 1.5, 1.45)
    spring = entry(("return_spring",), 8.0, 8.0)
    alone = {"latch": catch, "return_spring": spring}
    monkeypatch.setattr(search, "without", lambda fit, name: next(n for n in fit.theory.names if n != name))
    monkeypatch.setattr(choose, "judged", lambda name, folds: alone[name])
    monkeypatch.setattr(choose, "loosened", lambda j, folds: j)
    monkeypatch.setattr(objections, "bounded", lambda j: False)
    assert earned(both, base, search, (), 1.4, ChoiceSettings()).names == kept


def test_flanks_that_give_way_are_found(tmp_path: Path):
    """Begun from flanks of a slack that give way not at all, a fit of motions in which they do stays there."""
    search = search_on(tmp_path, measured_of(12, servo=True))
    theory = Theory(search.problem, ("backlash",), relaxed=True)
    real = {"width": 0.05, "drive_inertia": 0.5 * INERTIA, "give": 0.006, "springy": 0.1}
    truth = fitted(theory, search.train, at(theory, **real), iterations=0)
    runs = told_by(truth, search.train)
    plain = Theory(search.problem, ("backlash",))
    stiff = fitted(plain, runs, at(plain, **real), truth.starts)
    free = relaxed(stiff, runs)
    assert stiff.level > 2.0 and free.level == pytest.approx(1.0, abs=0.2)
    assert free.values["backlash form", "give"] == pytest.approx(0.006, rel=0.3)


def test_a_catch_that_was_looked_for_beside_its_place_is_found(tmp_path: Path):
    """Where it holds shows in when it lets go alone: no slope leads there."""
    search = search_on(tmp_path, measured_of(15))
    theory, real = Theory(search.problem, ("latch",)), {"hold": 0.6, "position": 0.2, "travel": 0.12, "capture": 0.5}
    truth = fitted(theory, search.train, at(theory, **real), iterations=0)
    search.train = told_by(truth, search.train)
    beside = at(theory, **(real | {"hold": 0.7, "position": 0.24, "travel": 0.16, "capture": 0.3}))
    stuck = fitted(theory, search.train, beside, truth.starts)
    found = search._finished(caught(stuck, search.train))
    free = relaxed(stuck, search.train)
    assert stuck.level > 3 and found.level < 1.1 and free.level < 1.2
    assert found.values["latch", "position"] == pytest.approx(0.2, abs=0.01)


@pytest.mark.parametrize("rise, hollow", [(0.001, True), (0.05, False)])
def test_friction_that_hardly_sticks_more_at_rest_is_plain(tmp_path: Path, rise: float, hollow: bool):
    """At rest it is larger only while it builds up, as the library's friction does not."""
    search = search_on(tmp_path, measured_of(28, dry=0.1))
    theory = Theory(search.problem, ("stribeck_friction",))
    point = {"level": 0.1, "rise": rise, "speed": 0.3}
    theta = np.array([point.get(r.name, r.neutral) for r in theory.ranges()])
    fit = fitted(theory, search.train, theta, iterations=0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(objections, "prompt", lambda fit, runs: fit)
        assert objections.hollow(Judged(fit, fit.residuals), search) == hollow


def test_a_joint_that_hardly_moves_says_nothing(tmp_path: Path):
    found = verdict(tmp_path, measured_of(17, largest=4e-3, dry=0.0, viscous=0.3))
    assert found.verdict == "not_excited" and found.next_experiment


def test_without_marks_every_run_is_held_out_in_turn(tmp_path: Path):
    measured = measured_of(18, marked=False, viscous=0.1, runs=3, seconds=3.0)
    found = verdict(tmp_path, measured)
    assert (found.verdict, names(found)) == ("named", {"viscous_damping"})
    runs, _ = fit_runs(measured, plant_of(read_asset(asset_of(tmp_path), "j"), measured))
    folds = folds_of(runs)
    assert sorted(run.name for fold in folds for run in fold.test) == sorted(run.name for run in runs)
    assert all(not {r.name for r in fold.train} & {r.name for r in fold.test} for fold in folds)


def test_a_single_run_is_cut(tmp_path: Path):
    found = verdict(tmp_path, measured_of(19, marked=False, runs=1, seconds=9.0, viscous=0.1, largest=1.5))
    assert (found.verdict, names(found)) == ("named", {"viscous_damping"})


def test_noise_is_no_evidence(tmp_path: Path):
    """The p-value of the best of many is at most what is claimed, for directions that have nothing to do with noise."""
    from types import SimpleNamespace

    rng = np.random.default_rng(3)
    tried, alarms = 10, 0
    for _ in range(400):
        noise = rng.normal(size=500)
        base = SimpleNamespace(strict={"a": noise})
        moves = rng.normal(size=(tried, 500)) / np.sqrt(500) * rng.uniform(0, 4, (tried, 1))
        best = min((noise - move for move in moves), key=lambda r: r @ r)
        alarms += p_value(base, SimpleNamespace(strict={"a": best}), tried) < 0.05  # type: ignore[arg-type]
    assert alarms <= 0.05 * 400


def test_the_wrong_joint_costs_one_line(tmp_path: Path):
    asset = read_asset(asset_of(tmp_path), "j")
    for wrong, said in (({"joint": "k"}, "it has no movable joint 'k'"), ({"joint_type": "prismatic"}, "is revolute")):
        with pytest.raises(FreeArtError, match=said) as caught:
            find_gap(asset, replace(measured_of(0), **wrong))
        assert "\n" not in str(caught.value)
