"""Which tests run when: `-m quick` (`make check`), `-m torch` (`make test-torch`), all others (`make test`)."""

import re
from collections import Counter

import pytest

QUICK = {
    "camera", "captures", "doctor", "effects", "files", "joint", "joint_asset", "layers", "measured",
    "metrics", "se3", "shapes", "statistics", "view",
}  # fmt: skip
"""Files that take a few seconds each, imports included."""
SLOW = ("gap_choose", "pipeline", "whole_path", "gap_fit", "reconstruct", "examples", "export", "check_asset")
"""Files that begin: if one of them came last, a core would be idle meanwhile. The first two compile the kernels of
simgap and of reconstruct, so that no two processes compile the same."""
TORCH = {"brought_priors", "gaussian_backends", "joint_batch", "maniskill", "maniskill_many", "priors"}
"""Files whose tests all need PyTorch or ManiSkill."""
SOME_TORCH = {"baselines": "masked_icp", "examples": "maniskill", "jobs": "ray"}
"""Files with some tests that need them, or Ray, or Open3D: those with this word in their names."""


def _subject(path):
    return path.stem.removeprefix("test_")


def pytest_ignore_collect(collection_path, config):
    """Files without a test that runs are not even imported."""
    if collection_path.suffix == ".py":
        wanted = {"quick": QUICK, "torch": TORCH | {*SOME_TORCH}}.get(config.option.markexpr)
        subject = _subject(collection_path)
        if subject in TORCH if wanted is None else subject not in wanted:
            return True


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: SLOW.index(_subject(item.path)) if _subject(item.path) in SLOW else len(SLOW))
    for item in items:
        subject = _subject(item.path)
        if subject in QUICK:
            item.add_marker("quick")
        if subject in TORCH or (subject in SOME_TORCH and SOME_TORCH[subject] in item.name):
            item.add_marker("torch")


def pytest_terminal_summary(terminalreporter):
    """How many tests were skipped, and why."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(
        re.sub(".*(not (here|at hand|on this machine|beside)|no PartNet).*", "outside data are not here", text)
        for text in (report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    )
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"{count} skipped: {reason}")


@pytest.fixture(scope="session")
def data(tmp_path_factory):
    """A data folder of made-up sequences: `a` and `c` revolute, `b` prismatic. Tests leave it as it is."""
    from score_files import write_data

    return write_data(tmp_path_factory.mktemp("made-up") / "data")


@pytest.fixture
def few_samples(monkeypatch):
    """strict-1 and strict-2 with few samples, in this process."""
    from score_files import few_samples as use_few_samples

    use_few_samples(monkeypatch)
