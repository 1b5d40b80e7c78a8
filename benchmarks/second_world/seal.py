"""Data apart from labels: what stands in a draw's folder tells nothing, and its hashes say that nobody changed it
afterwards.

OUT/cases/ID/ is what `gap` sees, OUT/manifest.json the SHA-256 of every file of it and of the labels; the labels, with
the salt from which the ids are, are in a folder of their own. Answers are hashed in OUT/answers.json before the labels
are opened.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from benchmarks.second_world import draw as d
from benchmarks.second_world import sensor
from benchmarks.second_world.hidden import true_value
from benchmarks.second_world.strength import hidden

LABELS = "labels.json"


def sha256(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def write_json(path: Path, doc: object) -> None:
    """Whole or not at all."""
    path.parent.mkdir(parents=True, exist_ok=True)
    new = path.with_name(path.name + ".new")
    new.write_text(json.dumps(doc, indent=1) + "\n")
    new.replace(path)


def salt_in(sealed: Path) -> str:
    """The draw's salt, from nothing but chance, kept with the labels."""
    path = sealed / "salt.json"
    if not path.is_file():
        write_json(path, secrets.token_hex(32))
    return json.loads(path.read_text())


def case_id(salt: str, index: int) -> str:
    """Ten hex digits that follow nothing: neither the order of the cases nor what they are."""
    return hashlib.sha256(f"{salt}/{index}".encode()).hexdigest()[:10]


def label(case: d.Case) -> dict:
    """What is hidden, in one object."""
    spec = case.spec
    effects = [
        {
            "name": e.name,
            "size": e.size,
            "form": e.form,
            "same_form": e.same_form,
            "value": true_value(e),
            "unit": e.unit,
        }
        for e in case.effects
    ]
    told = case.nuisance
    return {
        "stratum": spec.stratum,
        "kind": spec.kind,
        "protocol": spec.protocol,
        "effects": effects,
        "floors": list(case.floors),
        "group": list(spec.group),
        "inertia": 1 + told.inertia,
        "known_force": case.plan.has_effort or case.plan.has_command,
        "steady_load": spec.kind in ("drawer", "door"),
        "nuisance": asdict(told),
    }


def make(spec: d.Spec, seed: int, index: int, salt: str, out: Path, sealed: Path) -> None:
    """One case, drawn, measured and written; left alone where it is there already."""
    name = case_id(salt, index)
    folder, secret = out / "cases" / name, sealed / "cases" / f"{name}.json"
    if folder.exists() and secret.exists():
        return
    case = d.draw_case(spec, seed, index)
    p, sensing = hidden(case.machine, case.nuisance, list(case.effects))
    rng = np.random.default_rng([seed, 2, index])
    readings = sensor.read(p, sensing, case.plan, case.encoder, rng)
    new = out / "cases" / f".{name}"
    shutil.rmtree(new, ignore_errors=True)
    shutil.rmtree(folder, ignore_errors=True)
    sensor.write(new, case.machine, case.plan, readings)
    write_json(secret, label(case))
    new.replace(folder)


def close(seed: int, salt: str, indices: list[int], out: Path, sealed: Path) -> None:
    """Labels in one file, and the manifest of everything."""
    names = [case_id(salt, i) for i in indices]
    labels = {name: json.loads((sealed / "cases" / f"{name}.json").read_text()) for name in names}
    write_json(sealed / LABELS, {"seed": seed, "salt": salt, "cases": labels})
    files = sorted(path for name in names for path in (out / "cases" / name).rglob("*") if path.is_file())
    hashes = {str(path.relative_to(out)): sha256(path) for path in files}
    write_json(
        out / "manifest.json", {"cases": sorted(names), "files": hashes, "labels_sha256": sha256(sealed / LABELS)}
    )


def seal_answers(out: Path) -> None:
    """Hashes of all verdicts, written before any label is opened; an answer that is changed later is found out."""
    manifest = json.loads((out / "manifest.json").read_text())
    answers = {name: sha256(out / "answers" / f"{name}.json") for name in manifest["cases"]}
    write_json(out / "answers.json", {"manifest_sha256": sha256(out / "manifest.json"), "answers": answers})


def opened(out: Path, sealed: Path) -> tuple[dict, dict]:
    """Labels and answers by case id, after all hashes have been looked at; ValueError where one is not what it was."""
    manifest = json.loads((out / "manifest.json").read_text())
    held = json.loads((out / "answers.json").read_text())
    checks = [(out / "manifest.json", held["manifest_sha256"]), (sealed / LABELS, manifest["labels_sha256"])]
    checks += [(out / file, sha) for file, sha in manifest["files"].items()]
    checks += [(out / "answers" / f"{name}.json", sha) for name, sha in held["answers"].items()]
    for path, sha in checks:
        if not path.is_file() or sha256(path) != sha:
            raise ValueError(f"{path}: not the file that was sealed (SHA-256 {sha[:12]}...)")
    answers = {name: json.loads((out / "answers" / f"{name}.json").read_text()) for name in manifest["cases"]}
    return json.loads((sealed / LABELS).read_text())["cases"], answers
