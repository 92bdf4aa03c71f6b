"""What the methods of a cell must have in common."""

import pytest

from ablations.suite.evaluation import check_same_views


def test_methods_of_a_cell_are_measured_on_the_same_views():
    check_same_views("fox, 3dgs", {})
    check_same_views("fox, 3dgs", {"raw": ("a", "b"), "ours": ("a", "b")})
    with pytest.raises(RuntimeError, match=r"fox, 3dgs: methods were measured on different views \(raw, ours\)"):
        check_same_views("fox, 3dgs", {"raw": ("a", "b"), "ours": ("a",)})
