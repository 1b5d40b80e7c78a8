"""A data folder whose list would be too long to read is not started."""

import pytest

from freeart21.errors import FreeArtError
from generator.dataset import procedural_jobs, record_jobs
from generator.session import RecordSettings


def test_a_list_that_would_be_too_long_to_read_is_refused_before_anything_is_made(tmp_path):
    jobs = procedural_jobs("Stapler", 500, 0, RecordSettings())
    with pytest.raises(
        FreeArtError, match=r"about 7\d MiB, at most 64 are read; record some into folders of their own"
    ):
        record_jobs(tmp_path / "data", jobs)
    assert not (tmp_path / "data").exists()
