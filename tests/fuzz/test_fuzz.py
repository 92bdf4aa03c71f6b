"""A slice of the campaign of bad inputs; `nox -s fuzz` runs all of it."""

import pytest

from fuzz.campaign import run, summary


@pytest.mark.parametrize("cases", [30, pytest.param(120, marks=pytest.mark.slow)])
def test_no_reader_crashes_or_reads_what_is_wrong(cases: int) -> None:
    records = run(cases)
    total, *rows = summary(records)
    bad = [row for row in rows if "case" in row]
    assert total["commit"]
    assert not bad
    assert len(records) == cases
    assert {record["verdict"] for record in records} == {"refused", "right"}
