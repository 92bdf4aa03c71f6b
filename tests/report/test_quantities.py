import pytest

from gaussian_enhancer.report.quantities import Quantity


@pytest.mark.parametrize(
    ("gain", "written"), [(-300.0, "−300.00"), (5.0, "+5.00"), (0.004, "±0.00"), (float("nan"), "–")]
)
def test_a_difference_of_a_quantity_without_a_direction_is_written_with_its_sign(gain: float, written: str) -> None:
    count = Quantity("gaussians", "Gaussians", 2)
    assert count.verdict(gain) == "same"
    assert count.format_gain(gain) == written
