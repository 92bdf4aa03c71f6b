import math

import pytest

from gaussian_enhancer.metrics.tradeoff import Point


@pytest.mark.parametrize("value", [math.nan, math.inf, -1.0])
def test_points_without_a_place_are_refused(value) -> None:
    with pytest.raises(ValueError, match="cost of a"):
        Point("a", value, 1.0)
    with pytest.raises(ValueError, match="error of a"):
        Point("a", 1.0, value)
