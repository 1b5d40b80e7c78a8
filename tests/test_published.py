"""The published tables are of known protocols; and are never ranked."""

from leaderboard.protocols import DEFAULT, PROTOCOLS
from leaderboard.published import PUBLISHED


def test_every_number_is_one_of_its_protocol_and_of_none_that_ranks():
    for row in PUBLISHED:
        rules = PROTOCOLS[row.protocol]
        assert not rules.ranking and row in rules.published and row.values
        for id in row.values:
            assert rules.metric(id).unit(row.group) or row.group == "all", (row, id)
    assert [name for name, rules in PROTOCOLS.items() if rules.ranking] == ["strict-2", DEFAULT]
    assert PROTOCOLS[DEFAULT].published == ()


def test_no_line_stands_twice():
    lines = [(row.protocol, row.dataset, row.group, row.method, id) for row in PUBLISHED for id in row.values]
    assert len(lines) == len(set(lines))
