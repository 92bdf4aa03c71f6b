"""A slice of the campaign of bad inputs; `nox -s fuzz` runs all of it."""

from fuzz.campaign import run, summary

SLICE = 120


def test_no_reader_crashes_or_reads_what_is_wrong() -> None:
    records = run(SLICE)
    bad = [row for row in summary(records) if "case" in row]
    assert not bad
    assert len(records) == SLICE
    assert {record["verdict"] for record in records} == {"refused", "right"}
