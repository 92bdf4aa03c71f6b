"""What the coverage-guided campaign makes of libFuzzer's words; `nox -s fuzz -- --coverage` runs it."""

from fuzz.coverage_guided import outcome

WELL = "#2048\tpulse  cov: 311 ft: 420\nDone 5120 runs in 61 second(s)\nstat::number_of_executed_units: 5120\n"
BADLY = """\
#512\tpulse  cov: 99 ft: 120
 === Uncaught Python exception: ===
OverflowError: cannot fit 'int' into an index-sized integer
==7== ERROR: libFuzzer: fuzz target exited
stat::number_of_executed_units: 777
"""


def test_a_reader_that_holds_is_handled() -> None:
    assert outcome(0, WELL) == {"inputs": 5120, "edges": 311, "verdict": "handled"}


def test_a_reader_that_breaks_has_failed_and_says_how() -> None:
    found = outcome(77, BADLY)
    assert (found["verdict"], found["inputs"], found["edges"]) == ("failed", 777, 99)
    assert "OverflowError: cannot fit" in found["detail"]


def test_a_fuzzer_that_never_began_has_failed() -> None:
    assert outcome(0, "")["verdict"] == "failed"
    assert "ended with 1" in outcome(1, "")["detail"]
