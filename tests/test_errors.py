"""What a user's mistake says."""

import pickle

import pytest

from gaussian_enhancer.errors import InputError, refuse_unknown

FULL = InputError("disk", "is full", "free some space")


def test_a_users_mistake_survives_another_process() -> None:
    again = pickle.loads(pickle.dumps(FULL))
    assert (type(again), str(again), again.remedy) == (InputError, "disk: is full; free some space", "free some space")


def test_what_a_file_says_cannot_break_the_line_or_fill_the_screen() -> None:
    text = str(InputError("a\nb", "\x1b[2J" + "x" * 100_000, "write it again"))
    assert text.isprintable()
    assert len(text) < 1000
    assert text.startswith("a\\nb: \\x1b[2J")
    assert text.endswith("; write it again")


def test_an_unknown_name_is_refused_with_those_that_are_known() -> None:
    refuse_unknown("rows", None, ("a", "b"))
    refuse_unknown("rows", ["b", "a"], ("a", "b"))
    with pytest.raises(InputError, match="rows: names 'c'; choose from b, a"):
        refuse_unknown("rows", ["a", "c"], ("b", "a"))
