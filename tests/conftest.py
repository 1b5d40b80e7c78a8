"""Which tests are quick: `pytest -m quick`, which `make check` runs; and which files begin."""

from pathlib import Path

import pytest

QUICK = {  # file to CPU seconds alone, imports included, measured on two cores of a shared x86-64 machine
    "camera": 0.8,
    "captures": 1.1,
    "diagnostics": 2.5,
    "docker": 0.3,
    "doctor": 1.2,
    "effects": 3.2,
    "files": 2.1,
    "joint": 0.8,
    "joint_asset": 2.1,
    "kernels": 2.6,
    "labels": 6.0,
    "layers": 1.9,
    "measured": 1.1,
    "metrics": 2.8,
    "one_euro": 1.3,
    "package": 0.3,
    "registration": 2.5,
    "se3": 1.5,
    "shapes": 0.9,
    "statistics": 2.5,
    "teleop_certificate": 0.9,
    "view": 3.0,
    "vocabulary": 0.8,
}


SLOW = (
    "gap_choose",
    "gap_fit",
    "whole_path",
    "examples",
    "reconstruct",
    "gaussian_optimisation",
    "pipeline",
    "export",
    "check_asset",
)
"""Files of 45 CPU seconds and more: if one of them came last, a core would be idle meanwhile."""


def pytest_ignore_collect(collection_path, config):
    """Of the quick tests alone, other files are not even imported: that took ten seconds."""
    if config.option.markexpr == "quick" and collection_path.suffix == ".py" and _subject(collection_path) not in QUICK:
        return True


def _subject(path):
    return Path(path).stem.removeprefix("test_")


def pytest_collection_modifyitems(items):
    items.sort(key=lambda item: SLOW.index(_subject(item.path)) if _subject(item.path) in SLOW else len(SLOW))
    for item in items:
        if _subject(item.path) in QUICK:
            item.add_marker(pytest.mark.quick)


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
