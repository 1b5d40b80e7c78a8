"""The world in which effects are hidden: its equations hold, its two engines agree, its seals hold, nothing leaks."""

from __future__ import annotations

import ast
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from benchmarks.hidden_world import cases, effects, leak, mujoco_world, nuisance, ode, poses, sealed
from benchmarks.hidden_world.body import FAMILIES, draw_body
from benchmarks.hidden_world.cases import Wish
from benchmarks.hidden_world.ode import COMMANDED, ELASTIC, EXTERNAL, GAP, Drive, World, nothing, simulate
from benchmarks.hidden_world.strength import Gap, Hidden, changed

HIDDEN = Path(__file__).parents[1] / "benchmarks" / "hidden_world"
TIMES = np.linspace(0.0, 4.0, 401)
PENDULUM = World(inertia=0.2, gravity_sine=-6.0, gravity_cosine=0.3)


def wave(times, hertz=0.8, size=0.4):
    held = np.arange(len(times)) // 5 * 5
    return size * np.sin(2 * np.pi * hertz * times[held])


SERVO = Drive(TIMES, wave(TIMES), True, np.zeros(len(TIMES)), ode.NO_EFFORT)
PUSH = Drive(TIMES, np.zeros(len(TIMES)), False, wave(TIMES, size=3.0), EXTERNAL)


def test_it_imports_nothing_of_the_product_and_no_sapien():
    banned = {"freeart21", "generator", "reconstruct", "export", "leaderboard", "simgap", "sapien", "mani_skill"}
    for path in HIDDEN.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0, path
                names = [node.module or ""]
            if isinstance(node, ast.Call) and getattr(node.func, "id", "") == "__import__":
                names = ["sapien"]
            assert not {name.split(".")[0] for name in names} & banned, path


# the equations


def exact(slope, y0, times, events=(), bounce=None):
    """(n, k) solution by scipy, going on after each event from the state that `bounce(which, y)` gives."""
    out = np.empty((len(times), len(y0)))
    now, y, done = times[0], np.array(y0, float), 0
    while done < len(times):
        found = solve_ivp(slope, (now, times[-1]), y, events=list(events), dense_output=True, rtol=1e-11, atol=1e-12)
        upto = int(np.searchsorted(times, found.t[-1], side="right"))
        out[done:upto] = found.sol(times[done:upto]).T
        done, now, y = upto, found.t[-1], found.y[:, -1]
        if found.status != 1:
            break
        which = next(k for k, e in enumerate(found.t_events) if len(e))
        y = bounce(which, y)
    return out


def test_a_smooth_world_is_as_scipy_solves_it():
    w = PENDULUM._replace(
        viscous=0.05, viscous_power=1.1, drag=0.02, drag_power=1.9, spring=2.0, spring_rest=0.3, hardening=0.2,
        detent=0.8, detent_centre=0.1, detent_width=0.08, cogging=0.2, cogging_count=9.0, cable=0.05, cable_reach=2.0,
    )  # fmt: skip

    def slope(t, y):
        q, v = y
        r = (q - 0.1) / (0.08 * np.sqrt(5))
        force = -6 * np.sin(q) + 0.3 * np.cos(q) - np.sign(v) * (0.05 * abs(v) ** 1.1 + 0.02 * abs(v) ** 1.9)
        force += -2 * (q - 0.3) * (1 + 0.2 * (q - 0.3) ** 2) + 0.2 * np.sin(9 * q) - 0.05 * np.sinh(1.5 * q)
        force += -0.8 * r * (1 - r * r) ** 2 * 25 * np.sqrt(5) / 16 * (abs(r) < 1)
        return [v, force / 0.2]

    found = simulate(w, 1.2, 0.0, TIMES, nothing(TIMES))
    assert np.abs(found - exact(slope, [1.2, 0.0], TIMES)).max() < 2e-5


def test_a_stop_gives_back_its_part_of_the_speed():
    w = World(inertia=0.2, gravity_constant=-2.0, lower=0.0, upper=5.0, restitution=0.6)
    hits = [lambda t, y: y[0]]
    hits[0].terminal, hits[0].direction = True, -1  # type: ignore[attr-defined]
    times = TIMES[:130]
    expected = exact(lambda t, y: [y[1], -10.0], [1.0, 0.3], times, hits, lambda k, y: [0.0, -0.6 * y[1]])
    assert np.abs(simulate(w, 1.0, 0.3, times, nothing(times)) - expected).max() < 1e-6
    dead = simulate(w._replace(restitution=0.0), 1.0, 0.0, TIMES, nothing(TIMES))
    assert np.abs(dead[60:]).max() == 0.0


def test_dry_friction_sticks_and_stays():
    w = PENDULUM._replace(dry=0.9)
    found = simulate(w, 1.2, 0.0, TIMES, nothing(TIMES))
    now, y, expected = 0.0, np.array([1.2, 0.0]), np.empty(len(TIMES))

    def pull(q):
        return -6 * np.sin(q) + 0.3 * np.cos(q)

    while True:
        if abs(pull(y[0])) <= 0.9:
            expected[now - 1e-12 <= TIMES] = y[0]
            break
        way = np.sign(pull(y[0]))

        def stop(t, y, way=way):
            return way * y[1]

        stop.terminal, stop.direction = True, -1  # type: ignore[attr-defined]
        run = solve_ivp(
            lambda t, y, way=way: [y[1], (pull(y[0]) - way * 0.9) / 0.2], (now, 4.0), [y[0], way * 1e-12],
            events=stop, dense_output=True, rtol=1e-11, atol=1e-13,
        )  # fmt: skip
        here = (now <= TIMES) & (run.t[-1] >= TIMES)
        expected[here] = run.sol(TIMES[here])[0]
        now, y = run.t[-1], run.y[:, -1]
        if run.status != 1:
            break
    assert np.abs(found[:, 0] - expected).max() < 2e-6
    assert np.ptp(found[300:, 0]) == 0.0  # it sits, on a slope


def test_a_latch_opens_and_catches_where_it_should():
    w = World(inertia=0.2, latch=2.0, latch_position=0.3, latch_travel=0.1, latch_capture=0.5, spring=3.0)
    found = simulate(w, 1.0, 0.0, TIMES, nothing(TIMES))
    caught = [False]

    def slope(t, y):
        force = -3 * y[0] - caught[0] * 2 * np.sin(0.5 * np.pi * (y[0] - 0.3) / 0.1)
        return [y[1], force / 0.2]

    events = [lambda t, y: abs(y[0] - 0.3) - (0.1 if caught[0] else 0.05)]
    events[0].terminal = True  # type: ignore[attr-defined]

    def flip(k, y):
        caught[0] = not caught[0]
        return y

    expected = exact(slope, [1.0, 0.0], TIMES, events, flip)
    assert np.abs(found - expected).max() < 1e-4
    assert found[:, 0].max() == pytest.approx(1.0) and np.abs(found[200:, 0]).max() < 0.99  # catching costs work


def test_dry_friction_builds_up_spring_by_spring_and_the_slack_has_two_flanks():
    w = PENDULUM._replace(friction=0.4, friction_rise=0.3, friction_speed=0.5, travel=1e-3)
    part, reach = np.array(ode.SHARES), 1e-3 * np.array(ode.REACHES)
    k = 0.7 * part / reach

    def slope(t, y):
        q, v, z = y[0], y[1], y[2:]
        most = part * (0.4 + 0.3 * np.exp(-abs(v) / 0.5)) / k
        holds = z * np.sign(v) < 0.98 * most
        dry = (k * np.clip(z, -most, most)).sum() + np.sqrt((k * holds).sum() * 0.2) * v
        return np.r_[v, (-6 * np.sin(q) + 0.3 * np.cos(q) - dry) / 0.2, np.full(4, v)]

    y, stretched = np.r_[1.2, np.zeros(5)], [1.2]
    some = TIMES[:150]
    for _ in some[1:]:  # Heun's steps of 20 microseconds, springs bound after each
        for _ in range(500):
            here = slope(0, y)
            y = y + 1e-5 * (here + slope(0, y + 2e-5 * here))
            most = part * (0.4 + 0.3 * np.exp(-abs(y[1]) / 0.5)) / k
            y[2:] = np.clip(y[2:], -most, most)
        stretched.append(y[0])
    assert np.abs(simulate(w, 1.2, 0.0, some, nothing(some))[:, 0] - stretched).max() < 2e-4
    assert np.abs(simulate(w, 1.2, 0.0, some, nothing(some), step=1e-5)[:, 0] - stretched).max() < 5e-5

    w = PENDULUM._replace(link=GAP, link_width=0.05, link_inertia=0.04, link_stiffness=5e5, link_damping=2.0)

    def two(t, y):
        q, v, x, u = y

        def contact(d, r):
            return 5e5 * max(d, 0) ** 1.5 * max(0, 1 + 2 * r)

        between = contact(x - q - 0.025, u - v) - contact(q - x - 0.025, v - u)
        return [v, (-6 * np.sin(q) + 0.3 * np.cos(q) + between) / 0.2, u, -between / 0.04]

    part = TIMES[:201]
    loose = solve_ivp(two, (0, 2), [1, 0, 1, 0], method="DOP853", t_eval=part, rtol=1e-10, atol=1e-12, max_step=1e-3)
    assert np.abs(simulate(w, 1.0, 0.0, part, nothing(part))[:, 0] - loose.y[0]).max() < 3e-4


def test_a_command_comes_late_and_lags():
    w = World(inertia=0.2, stiffness=20.0, damping=1.4, gain=0.8, delay=0.033, lag=0.012)
    found = simulate(w, 0.0, 0.0, TIMES, SERVO)
    now, y = 0.0, np.array([0.0, 0.0, SERVO.command[0]])
    expected = [0.0]
    for k in range(1, len(TIMES)):
        for end in (TIMES[k - 1] + 0.003, TIMES[k]):  # 33 ms are three samples and 3 ms
            u = SERVO.command[max(int(np.searchsorted(TIMES, 0.5 * (now + end) - 0.033, side="right")) - 1, 0)]
            run = solve_ivp(
                lambda t, y, u=u: [y[1], 0.8 * (20 * (y[2] - y[0]) - 1.4 * y[1]) / 0.2, (u - y[2]) / 0.012],
                (now, end), y, rtol=1e-9, atol=1e-11,
            )  # fmt: skip
            now, y = end, run.y[:, -1]
        expected.append(y[0])
    assert np.abs(found[:, 0] - expected).max() < 1e-5


@pytest.mark.parametrize("e", [0.1, 0.4, 0.8])
def test_a_soft_stop_gives_the_restitution_that_was_asked_for(e: float):
    stiffness = 1.25 / 0.0015**2.5
    w = World(lower=-9.0, upper=0.5, stop_stiffness=stiffness, stop_loss=effects._loss(e))
    assert simulate(w, 0.0, 1.0, TIMES, nothing(TIMES))[-1, 1] == pytest.approx(-e, abs=1e-3)


SHAFT = {"link": ELASTIC, "link_inertia": 0.1, "link_stiffness": 6500.0, "link_damping": 3.3}
BOTH = {
    "free": (PENDULUM, nothing(TIMES), 1.2),
    "viscous": (PENDULUM._replace(viscous=0.05), nothing(TIMES), 1.2),
    "drag": (PENDULUM._replace(drag=0.03), nothing(TIMES), 1.2),
    "spring": (PENDULUM._replace(spring=3.0, spring_rest=0.3, hardening=0.2), nothing(TIMES), 1.2),
    "sliding": (PENDULUM._replace(dry=0.3), nothing(TIMES), 1.2),
    "stop": (PENDULUM._replace(lower=-0.6, upper=1.6), nothing(TIMES), 1.2),
    "gain": (PENDULUM._replace(gain=0.7, stiffness=20.0, damping=1.4), SERVO, 0.0),
    "armature": (PENDULUM._replace(stiffness=20.0, damping=1.4, **SHAFT), SERVO, 0.0),
    "pushed": (World(inertia=0.2, dry=0.6, lower=-1.0, upper=1.0), PUSH, 0.0),
    "commanded": (World(inertia=0.2, viscous=0.3, gain=0.6), PUSH._replace(effort_kind=COMMANDED), 0.0),
}


@pytest.mark.parametrize("name", BOTH)
def test_both_engines_agree_within_one_percent(name: str):
    world, drive, q0 = BOTH[name]
    ours = simulate(world, q0, 0.0, TIMES, drive)[:, 0]
    theirs = mujoco_world.simulate(world, q0, 0.0, TIMES, drive)[:, 0]
    assert np.abs(ours - theirs).max() < 0.01 * np.ptp(ours)
    other = simulate(world._replace(inertia=1.1 * world.inertia), q0, 0.0, TIMES, drive)[:, 0]
    assert np.abs(other - theirs).max() > 0.02 * np.ptp(ours)


def test_mujoco_refuses_what_it_cannot_say():
    assert not mujoco_world.able(PENDULUM._replace(friction=0.1))
    assert not mujoco_world.able(PENDULUM._replace(viscous=0.1, viscous_power=1.1))
    with pytest.raises(ValueError):
        mujoco_world.simulate(PENDULUM._replace(latch=1.0), 0.0, 0.0, TIMES, nothing(TIMES))


# what is hidden


def test_every_effect_of_the_library_is_hidden_somewhere():
    from freeart21.effects import EFFECTS

    younger = {"actuator_offset", "gear_friction"}  # than this world, whose draws are sealed: its next one hides them
    assert {*effects.START, *poses.KINEMATIC, *younger} == set(EFFECTS)
    assert not set(effects.STRANGE) & set(EFFECTS)
    named = {name for wish in cases.wishes(0, 0.01) for name in wish.names}
    assert named == {*effects.START, *effects.STRANGE, *poses.KINEMATIC}
    assert sum(not wish.names and wish.stratum == "null" for wish in cases.wishes(0)) >= 400


@pytest.fixture(scope="module")
def gaps() -> dict[str, Gap]:
    """What is told of the strength of anything hidden in one case of two families."""
    return {
        family: Gap(cases.draw_case(Wish("null", (), "full", family), 3, search=False))
        for family in ("pendulum", "drawer")
    }


@pytest.mark.parametrize("name", [*effects.START, *effects.STRANGE])
def test_every_hidden_effect_shows_in_the_motion(gaps: dict[str, Gap], name: str):
    gap = gaps["pendulum" if name in ("load_friction", "asymmetric_friction") else "drawer"]
    low, high = {**effects.START, **effects.STRANGE}[name]
    assert gap.ratio((Hidden(name, 3, high),)) >= 5
    assert gap.ratio((Hidden(name, 3, 1e-3 * low),)) < gap.ratio((Hidden(name, 3, high),))


def test_what_nuisance_may_be_is_no_gap(gaps: dict[str, Gap]):
    """However far the readings move: the same pull of gravity, and a rotor as heavy as the asset's doubt."""
    for family, name, size in (("pendulum", "gravity_offset", 0.01), ("drawer", "gravity_offset", 3e-3)):
        gap = gaps[family]
        moved = np.sqrt(np.mean(gap._change((Hidden(name, 3, size),)) ** 2)) / gap.floor
        assert moved > 5 and gap.ratio((Hidden(name, 3, size),), closely=True) < 2
    weak = cases.draw_case(Wish("single", ("viscous_damping",), "full", "drawer", "weak"), 3)
    clear = cases.draw_case(Wish("single", ("viscous_damping",), "full", "drawer"), 3)
    assert weak.hidden[0].size < clear.hidden[0].size and weak.ratio < 5 <= clear.ratio


@pytest.mark.parametrize("family", ["pendulum", "drawer"])
def test_springs_pull_together(gaps: dict[str, Gap], family: str):
    """Also with rails that bend: none takes the place of another when rivals are tried side by side."""
    body, base = gaps[family].case.body, gaps[family].base
    both = (*cases.any_of("return_spring"), *cases.any_of("gravity_offset"))
    world, places = changed(base, body, both)[0], np.linspace(body.lower, body.upper, 5)

    def pull(w: World) -> np.ndarray:
        fall = w.gravity_constant + w.gravity_cosine * np.cos(places) + w.gravity_sine * np.sin(places)
        return np.asarray(fall - w.spring * (places - w.spring_rest))

    alone = sum(pull(changed(base, body, (one,))[0]) - pull(base) for one in both)
    assert np.allclose(pull(world) - pull(base), alone) and np.ptp(alone) > 0.1 * body.force


def test_nuisance_is_always_on_and_nothing_else_in_a_null():
    for family in FAMILIES:
        case = cases.draw_case(Wish("null", (), "full", family), 5)
        asset, true = case.body.world(), nuisance.true_world(case.body, case.nuisance)
        differ = {name for name in World._fields if getattr(asset, name) != getattr(true, name)}
        assert "inertia" in differ and differ & {"gravity_cosine", "gravity_constant"}
        assert differ <= {"inertia", "gravity_cosine", "gravity_sine", "gravity_constant", "arm", "mass", "load_axial"}
        assert abs(true.inertia / asset.inertia - 1) <= nuisance.INERTIA_RELATIVE
        off = np.hypot(true.gravity_cosine - asset.gravity_cosine, true.gravity_sine - asset.gravity_sine)
        off = off if case.body.revolute else abs(true.gravity_constant - asset.gravity_constant)
        lever = case.body.arm if case.body.revolute else 1.0
        assert off <= nuisance.GRAVITY_VECTOR[family] * case.body.mass * 9.81 * lever
        run = sealed.runs_of(case)[0]
        assert len(run.times) == 491 and len(set(np.round(np.diff(run.times), 4))) > 20  # lost readings, jitter
        steps = run.q / case.nuisance.quantum
        assert np.abs(steps - np.round(steps)).max() < 1e-6


def test_the_urdf_says_the_body_that_moves(tmp_path: Path):
    from freeart21.files.asset import read_asset
    from generator.simulate import load

    rng = np.random.default_rng(2)
    for family in FAMILIES:
        body = draw_body(rng, family)
        (tmp_path / "object.urdf").write_text(body.urdf())
        asset = read_asset(tmp_path, "joint")
        loaded = load(asset, gravity=body.gravity)
        cosine, sine, constant = body.gravity_terms()
        assert loaded.joint_inertia == pytest.approx(body.inertia, rel=1e-5)
        for q in (body.lower, 0.3 * body.upper):
            expected = constant + cosine * np.cos(q) + sine * np.sin(q)
            assert loaded.mechanics.gravity_force(q) == pytest.approx(expected, abs=1e-5 * body.force)
        said = sum(e.name == "viscous_damping" for e in asset.effects.get("joint", ()))
        assert said == (body.damping > 0)


# seals


@pytest.fixture(scope="module")
def store(tmp_path_factory: pytest.TempPathFactory):
    """Small cases of one rig under seal; sizes of effects are the table's."""
    folder = tmp_path_factory.mktemp("sealed")
    vault = sealed.Vault(folder / "out", folder / "vault")
    names = list(effects.START)
    drawn = {}
    for i in range(40):
        family = ("pendulum", "door")[i // 2 % 2]
        hidden = (names[i // 4 % len(names)],) if i % 2 else ()
        wish = Wish("single" if hidden else "null", hidden, "full", family)
        drawn[sealed.case_id(9, i)] = cases.draw_case(wish, 400 + i, search=False)
    vault.seal(drawn)
    return vault, drawn


def test_nothing_but_the_measurement_tells_what_is_hidden(store):
    vault, drawn = store
    rows = np.array([leak.features(vault.out / "cases" / name) for name in drawn])
    told = np.array([bool(case.hidden) for case in drawn.values()], int)
    for classify in (leak.logistic, leak.nearest):
        assert leak.p_value(rows, told, classify, 39) > 0.02
        told_all = np.column_stack([rows, told + 0.1 * np.random.default_rng(0).normal(size=len(told))])
        assert leak.p_value(told_all[:, -1:], told, classify, 39) < 0.03  # a leak would be found
    sizes = {tuple(p.stat().st_size for p in sorted((vault.out / "cases" / n).rglob("*.*"))) for n in drawn}
    assert len(sizes) == 1
    text = " ".join(str(p.relative_to(vault.out)) for p in vault.out.rglob("*"))
    assert not any(name in text for name in effects.START)


def test_labels_open_only_after_the_verdicts_are_fixed(store, tmp_path: Path):
    vault, drawn = store
    name = next(iter(drawn))
    verdict = tmp_path / "verdict.json"
    verdict.write_text('{"verdict": "no_gap"}')
    with pytest.raises(sealed.SealBroken, match="never recorded"):
        vault.open({name: verdict})
    vault.record(name, verdict)
    assert vault.open({name: verdict})[name]["stratum"] == drawn[name].wish.stratum
    verdict.write_text('{"verdict": "named"}')
    vault.record(name, verdict)  # too late
    with pytest.raises(sealed.SealBroken, match="not the one that was recorded"):
        vault.open({name: verdict})
    verdict.write_text('{"verdict": "no_gap"}')
    lines = (vault.vault / "labels.jsonl").read_text()
    try:
        changed = [json.loads(line) for line in lines.splitlines()]
        changed[0]["stratum"] = "other"
        (vault.vault / "labels.jsonl").write_text("\n".join(map(json.dumps, changed)) + "\n")
        with pytest.raises(sealed.SealBroken, match="label"):
            vault.open({name: verdict})
    finally:
        (vault.vault / "labels.jsonl").write_text(lines)


@pytest.mark.parametrize("rig", ["full", "swing", "servo", "effort", "poses"])
def test_the_product_reads_every_rig(rig: str, tmp_path: Path):
    from freeart21.files.measured import read_measured

    case = cases.draw_case(Wish("null", (), rig, "pendulum"), 11, search=False)
    for path, content in sealed.files_of(case).items():
        (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / path).write_bytes(content)
    measured = read_measured(tmp_path / "measured")
    assert len(measured.runs) == 13 and sum(bool(run.held_out) for run in measured.runs) == 5
    assert np.allclose(measured.gravity, case.body.gravity, atol=1e-8)
    if rig == "poses":
        run = measured.runs[0]
        assert run.poses is not None and run.seen is not None and run.seen.sum() == len(run.seen) - sealed.LOST_FRAMES


def test_ideal_poses_turn_about_the_joint():
    body = replace(draw_body(np.random.default_rng(0), "pendulum"), lower=-1.0, upper=1.0)
    moved = poses.motion(body, np.array([0.0, 0.7]))
    assert np.allclose(moved[0], np.eye(4))
    assert np.allclose(moved[1] @ [*body.origin, 1], [*body.origin, 1])
    for name, (small, _) in poses.KINEMATIC.items():
        seen = poses.seen_motion(name, 1, small, body, np.linspace(-1, 1, 21), np.linspace(0, 2, 21))
        assert np.allclose(seen[:, :3, :3] @ seen[:, :3, :3].transpose(0, 2, 1), np.eye(3))
        assert np.abs(seen - poses.motion(body, np.linspace(-1, 1, 21))).max() > 0.5 * min(small, 0.003)
