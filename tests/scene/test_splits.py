import pytest
from hypothesis import given
from hypothesis import strategies as st

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.splits import Split, evenly_spaced, every_nth, thin_training


def test_every_eighth_is_held_out():
    assert every_nth(18) == (tuple(i for i in range(18) if i % 8), (0, 8, 16))
    assert every_nth(5, 2, 1) == ((0, 2, 4), (1, 3))
    assert every_nth(3, 0) == ((0, 1, 2), ())


@given(count=st.integers(2, 60), every=st.integers(2, 9), thin=st.integers(1, 5), unused=st.booleans())
def test_sides_never_overlap_and_thinning_only_moves_photos(count, every, thin, unused):
    train, test = Split(every, 1, thin, unused)(count)
    assert not set(train) & set(test)
    assert train == every_nth(count, every, 1)[0][::thin]
    assert set(every_nth(count, every, 1)[1]) <= set(test)
    if unused:
        assert sorted((*train, *test)) == list(range(count))


def test_files_own_split_is_followed_unless_refused():
    own = (0, 2, 4), (1,)
    assert Split()(6, own) == own
    assert Split(train_every=2)(6, own) == ((0, 4), (1,))
    assert Split(train_every=2, unused_as_test=True)(6, own) == ((0, 4), (1, 2))
    assert Split(3, own=False)(6, own) == ((1, 2, 4, 5), (0, 3))


def test_thinned_by_one_keeps_all():
    assert thin_training((1, 2), (0,), 1, True) == ((1, 2), (0,))


@pytest.mark.parametrize("values", [{"test_every": 1}, {"test_every": -2}, {"test_offset": 8}, {"train_every": 0}])
def test_impossible_numbers_are_refused(values):
    with pytest.raises(InputError, match=next(iter(values))):
        Split(**values)


def test_split_that_leaves_nothing_is_refused():
    with pytest.raises(InputError, match="leaves none of 2"):
        Split()(2, ((), (0, 1)))


@pytest.mark.parametrize(
    ("count", "chosen"), [(1, (0,)), (4, (0, 3, 7, 11)), (15, tuple(range(15))), (20, tuple(range(15)))]
)
def test_some_of_many_items_are_spaced_evenly(count, chosen):
    assert evenly_spaced(range(15), count) == chosen
    assert evenly_spaced([], count) == ()
