from ablations.study.missing import missing_record, reason_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.metrics.records import MISSING, read_records, write_records


def test_reasons_name_the_type_of_what_is_no_users_mistake() -> None:
    assert reason_of(InputError("disk", "is full", "free some space")) == "disk: is full; free some space"
    assert reason_of(KeyError("a")) == "KeyError: 'a'"
    assert reason_of(RuntimeError("out of memory")) == "RuntimeError: out of memory"


def test_a_missing_record_says_why_and_is_read_back(tmp_path):
    made = missing_record("ours", "is not trained", scene="fox", splat="3dgs/sparse", seed=1, sources={"fit": "fox-1"})
    assert (made.kind, made.metrics, made.reasons) == (MISSING, {}, {"row": "is not trained"})
    write_records(tmp_path / "found.jsonl", [made])
    assert read_records(tmp_path / "found.jsonl") == (made,)
