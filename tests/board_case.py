"""A board on this machine for tests: data with a hidden truth, a repository, and submissions of every kind."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
from synthetic_case import make_recording, make_truth

from benchmarks.gaming import Answer, dust, make_honest, noise_around, still
from freeart21.files.benchmark import write_benchmark
from freeart21.files.result import Method, write_method, write_result
from freeart21.files.sequence import write_sequence
from freeart21.files.truth import write_truth
from leaderboard.board.secret import OPTIONS
from leaderboard.pack import pack_public, pack_truth

TRUTHS = {"hinge": make_truth("revolute", 0), "slider": make_truth("prismatic", 1)}
SEQUENCES = tuple(TRUTHS)
PASSPHRASE = "correct horse battery staple"


def write_halves(folder: Path) -> dict[str, str]:
    """public.zip and truth.zip.enc in `folder`; gives the secrets that a runner needs, but for the signing key."""
    data = folder / "secret"
    for name, truth in TRUTHS.items():
        write_sequence(data / "sequences" / name, make_recording(truth, name), 1e-4)
        write_truth(data / "truth" / name, truth, 2)
    write_benchmark(data, "made-up", "1", "test")
    pack_public(data, folder / "public.zip", keep_names=True)
    pack_truth(data, folder / "truth.zip", keep_names=True)
    secrets = {"BOARD_TRUTH_KEY": PASSPHRASE, "BOARD_TRUTH_DEVELOPMENT": str(folder / "truth.zip.enc")}
    command = ["openssl", "enc", *OPTIONS, "-pass", "env:BOARD_TRUTH_KEY", "-in", str(folder / "truth.zip")]
    subprocess.run([*command, "-out", secrets["BOARD_TRUTH_DEVELOPMENT"]], env=os.environ | secrets, check=True)
    return secrets


def honest(answer: Answer) -> Answer:
    return answer


def gamed(answer: Answer) -> Answer:
    """Dust for the distances, noise for the views, and a joint that never moves."""
    return still(noise_around(dust(answer)))


def write_answers(folder: Path, name: str, change=honest, code: str = "", seed: int = 0) -> Path:
    """A results folder of a method."""
    for sequence, truth in TRUTHS.items():
        answer = change(make_honest(truth, (), 2, seed))
        write_result(folder / sequence, answer.given, renders=[np.asarray(r) for r in answer.renders])
    write_method(folder, Method(name, code))
    return folder


def zip_results(folder: Path, path: Path) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    shutil.make_archive(str(path.with_suffix("")), "zip", folder)
    return path


def write_traversal(path: Path) -> Path:
    """A ZIP whose entry lies outside of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("../../../run.sh", "#!/bin/sh\necho owned\n")
    return path


def git(folder: Path, *words: str) -> str:
    who = ["-c", "user.name=somebody", "-c", "user.email=somebody@example.org", "-c", "commit.gpgsign=false"]
    done = subprocess.run(["git", *who, "-C", str(folder), *words], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


def commit(folder: Path, message: str) -> None:
    git(folder, "add", "-A")
    git(folder, "commit", "-q", "-m", message)


def write_program(path: Path) -> Path:
    """`freeart21` of this Python as one program."""
    root = Path(__file__).resolve().parents[1]
    path.write_text(f'#!/bin/sh\nPYTHONPATH={root} exec {sys.executable} -m freeart21 "$@"\n')
    path.chmod(0o755)
    return path
