"""The hidden world of `gap` (benchmarks/world): its physics, its cases and its scorer."""

import json

import numpy as np
import pytest

from benchmarks import hidden_gap
from benchmarks.common import Ended
from benchmarks.world import draw, effects
from benchmarks.world import laws as w
from benchmarks.world.effects import Effect
from benchmarks.world.grade import grade
from benchmarks.world.machines import Nuisance, draw_machine, truth

KINDS = ("pendulum", "lid", "door", "drawer", "arm")
REST = Nuisance()


def machine(kind: str, seed: int = 5):
    return draw_machine(kind, np.random.default_rng(seed))


def hidden(m, name, size, **form):
    """Parameters of a machine with one effect, and nothing else off."""
    return effects.hide(m, REST, [Effect(name, size, form)])


def measure_energy(p, states):
    """(n,) J: kinetic, gravity's and a plain spring's; what is conserved where nothing else acts."""
    q, v = states[:, 0], states[:, 1]
    d = q - p[w.SPRING_Q]
    fall = -p[w.GA] * np.sin(q) + p[w.GB] * np.cos(q) - p[w.GC] * q
    return 0.5 * p[w.M] * v**2 + fall + p[w.SPRING] * (0.5 * d**2 + 0.25 * p[w.HARDEN] * d**4)


def swing(p, start, seconds=6.0, rate=200, longest=5e-5, force=0.0):
    """States (n, 5) of a joint that nobody touches but a constant force."""
    knots = np.linspace(0, seconds, int(seconds * rate) + 1)
    still = np.zeros((len(knots) - 1, 2))
    q, v = start
    return knots, w.integrate(p, knots, still, still + force, np.array([q, v, 0.0, q, v]), longest)


@pytest.mark.parametrize("kind", KINDS)
def test_energy_is_kept_where_nothing_acts(kind):
    m = machine(kind)
    p = truth(m, Nuisance(0.07, -0.03, (0.004, 0.003)))
    p[w.LOW], p[w.HIGH], p[w.KP], p[w.KD] = -1e9, 1e9, 0.0, 0.0
    _, states = swing(p, (0.4, 0.2), longest=1e-4)
    e = measure_energy(p, states)
    assert np.ptp(e) < 1e-9 * np.abs(e).max() + 1e-12
    assert np.ptp(states[:, 0]) > 0.3


REFERENCES = ["stribeck_friction", "load_friction", "detent", "magnet"]


@pytest.mark.parametrize("name", REFERENCES)
def test_it_agrees_with_an_adaptive_solver(name):
    """Against scipy's Radau at tight tolerances, over all the laws: what the fixed step leaves is under 1/100 of a
    quantum."""
    from scipy.integrate import solve_ivp

    rng = np.random.default_rng(8)
    m = machine("pendulum", 8)
    p = effects.hide(m, REST, [effects.draw_effect(name, m, rng)])
    t, states = swing(p, (0.9, 0.0), 2.0, 50, longest=w.longest_step(p))
    rest = lambda t, y: w._rates(p, t, y, 0.0, 0.0, False)  # noqa: E731
    fine = solve_ivp(rest, (0, 2), states[0], "Radau" if p[w.TRAVEL] else "DOP853", t, rtol=1e-8, atol=1e-11)
    assert np.abs(fine.y[0] - states[:, 0]).max() < 1.5e-5


def test_a_case_on_disk_reads_tells_nothing_and_is_the_same_twice(tmp_path):
    from freeart21.files.measured import read_measured

    spec = draw.Spec("null", (), "arm", "and pushed")
    for name in ("a", "b"):
        assert hidden_gap.draw(spec, 3, 0, tmp_path / name) is None
    folder = tmp_path / "a" / "cases" / "000"
    assert hidden_gap.hash_files(tmp_path / "a") == hidden_gap.hash_files(tmp_path / "b")
    read_measured(folder / "measured")
    text = "".join(f.read_text() for f in folder.rglob("*") if f.is_file())
    for word in (*effects.LAWS, *draw.COUNTS, "seed", "stratum"):
        assert word not in text
    assert json.loads((tmp_path / "a" / "labels" / "000.json").read_text())["effects"] == []
    (folder / "machine.urdf").write_text("changed")
    assert hidden_gap.hash_files(tmp_path / "a") != hidden_gap.hash_files(tmp_path / "b")


def test_a_draw_is_asked_scored_and_goes_on_where_it_was(tmp_path, monkeypatch):
    specs = [draw.Spec("null", (), "arm", "usual"), draw.Spec("null", (), "door", "usual")]
    commands = []

    def ended(limit, command, folder):
        commands.append(command)
        (folder / "answer").mkdir()
        verdict = {"verdict": "no_gap", "effects": [], "rivals": [], "gap": []}
        (folder / "answer" / "verdict.json").write_text(json.dumps(verdict))
        return Ended(0, "", 1.5, 2.0)

    monkeypatch.setattr(hidden_gap, "draw_specs", lambda share, seed: specs)
    monkeypatch.setattr(hidden_gap, "run_within", ended)
    monkeypatch.setattr(hidden_gap, "RESULTS", tmp_path)
    for _ in range(2):
        hidden_gap.main(tmp_path / "out")
    found = json.loads((tmp_path / "hidden_gap-dev.json").read_text())
    assert len(commands) == 2 and [row["outcome"] for row in found["rows"]] == ["right", "right"]
    assert found["seconds"] == {"median": 1.5, "most": 1.5} and len(found["cases_sha256"]) == 64
    with pytest.raises(SystemExit, match="another draw"):
        hidden_gap.main(tmp_path / "out", seed=2)
    with pytest.raises(SystemExit, match="is the release's"):
        hidden_gap.main(tmp_path / "out", seed=hidden_gap.RELEASE)


# The scorer, on verdicts made by hand.


def label(stratum, *names, kind="pendulum", protocol="usual", group=(), **more):
    effects = [{"name": n, "size": 0.2, "form": {}, "same_form": True, "value": 0.2, "unit": "N*m"} for n in names]
    base = {"stratum": stratum, "kind": kind, "protocol": protocol, "effects": effects, "floors": [9.0] * len(names)}
    return (
        base
        | {"group": list(group), "inertia": 1.1, "known_force": True, "steady_load": kind in ("drawer", "door")}
        | more
    )


def answer(verdict, *names, rivals=(), part=False, low=0.1, high=0.3):
    parameter = {"value": 0.2, "unit": "N*m", "low": low, "high": high}
    effects = [{"name": n, "parameters": {"torque": parameter}} for n in names]
    gap = [{"run": "run2", "before": 0.5, "after": 0.1, "floor": 0.1, "held_out": True}]
    doc = {"verdict": verdict, "in_part": part, "effects": effects, "rivals": [list(r) for r in rivals], "gap": gap}
    return {"seconds": 1.0, "exit": 0, "error": "", "verdict": doc}


C, L, V, Q = "coulomb_friction", "load_friction", "viscous_damping", "quadratic_drag"
G, E = "gravity_offset", "encoder_offset"
BOTH = (G, E)
HAND = [
    (label("clear", C), answer("named", C), "exact"),
    (label("clear", C), answer("named", C, part=True), "exact"),
    (label("clear", C), answer("named", L), "wrong"),
    (label("clear", C, kind="drawer"), answer("named", L), "by physics"),
    (label("clear", C, kind="drawer"), answer("ambiguous", C, rivals=[[C], [L]]), "by physics"),
    (label("clear", C), answer("ambiguous", C, rivals=[[C], [L]]), "open"),
    (label("clear", C), answer("ambiguous", V, rivals=[[V], [L]]), "wrong rivals"),
    (label("weak", C), answer("unexplained"), "refused"),
    (label("weak", C), answer("no_gap"), "missed"),
    (label("clear", C), {"seconds": 300, "exit": None, "error": "no answer", "verdict": None}, "failed"),
    (label("pair", C, Q), answer("named", Q, C), "exact"),
    (label("pair", C, Q), answer("named", C), "partly"),
    (label("outside", "cogging"), answer("unexplained"), "right"),
    (label("outside", "asymmetric_friction"), answer("named", C, part=True), "partly"),
    (label("outside", "asymmetric_friction"), answer("named", C), "overclaimed"),
    (label("outside", "asymmetric_friction"), answer("named", C, G, part=True), "wrong"),
    (label("null"), answer("no_gap"), "right"),
    (label("null"), answer("unexplained"), "alarm"),
    (label("still", V), answer("not_excited"), "right"),
    (label("still", V), answer("no_gap"), "near"),
    (label("gauge", G, group=BOTH), answer("ambiguous", G, rivals=[[G], [E]]), "right"),
    (label("gauge", G, group=BOTH), answer("ambiguous", G, rivals=[[G], [V]]), "open"),
    (label("gauge", G, group=BOTH), answer("named", E), "committed"),
]


@pytest.mark.parametrize(("truth_", "given", "outcome"), HAND, ids=[f"{i}-{row[2]}" for i, row in enumerate(HAND)])
def test_verdicts_made_by_hand_are_graded_as_they_ought(truth_, given, outcome):
    assert grade(truth_, given)["outcome"] == outcome
