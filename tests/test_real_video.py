"""How clips are graded by `benchmarks.real_video`."""

import pytest

from benchmarks.real_video import grade_clip

HINGE = {"type": "revolute", "travel": [77, 93], "axis": [0, 0, 1], "axis_within": 15}


def delivered(trust="sound", type="revolute", travel=85.0, axis=(0.0, 0.1, -0.995)):
    return {"type": type, "travel": travel, "axis": list(axis), "trust": trust, "last": "x"}


@pytest.mark.parametrize(
    ("row", "grade"),
    [
        (delivered(), "right"),
        (delivered("doubtful"), "doubted"),
        (delivered(travel=60.0), "wrong"),
        (delivered("doubtful", travel=60.0), "silent"),
        (delivered(axis=(0.0, 0.6, 0.8)), "wrong"),
        (delivered(type="prismatic", travel=0.1), "wrong"),
        ({"type": None, "last": "refused"}, "silent"),
    ],
)
def test_a_joint_is_graded_by_what_was_known(row, grade):
    assert grade_clip(HINGE, row)[0] == grade


@pytest.mark.parametrize(
    ("row", "grade"),
    [(delivered(), "wrong"), (delivered("doubtful"), "right"), ({"type": None, "last": "still"}, "right")],
)
def test_where_nothing_moves_only_a_sound_joint_is_wrong(row, grade):
    assert grade_clip({"type": "nothing"}, row)[0] == grade
