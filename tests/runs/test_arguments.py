"""Values of a configuration against the signatures of what it builds."""

import pytest
from omegaconf import OmegaConf

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.runs.arguments import check_arguments
from gaussian_enhancer.runs.instantiate import build

CAPTURE = {
    "_target_": "gaussian_enhancer.scene.capture.open_capture",
    "path": "nowhere",
    "split": {"_target_": "gaussian_enhancer.scene.splits.Split", "test_every": 8},
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"downscale": "abc"}, "scene.downscale: is 'abc'; give a number"),
        ({"downscale": float("nan")}, "scene.downscale: is nan; give a finite number"),
        ({"path": None}, "scene.path: is None; give"),
        ({"background": [0, 0]}, "scene.background"),
        ({"background": ["red", 0, 0]}, "scene.background.0: is 'red'; give a number"),
        ({"downscal": 2}, "scene.downscal: is no option of open_capture; choose path, downscale"),
        ({"split": {"test_every": "abc"}}, "scene.split.test_every: is 'abc'; give a whole number"),
        ({"split": "abc"}, "scene.split: is 'abc'; give a choice of its group"),
    ],
)
def test_a_value_of_another_type_is_named_as_on_the_command_line(change, message):
    cfg = OmegaConf.create({"scene": CAPTURE})
    with pytest.raises(InputError) as refusal:
        build(OmegaConf.merge(cfg, {"scene": change}).scene)
    assert message in str(refusal.value)


def test_right_values_pass():
    values = {**CAPTURE, "downscale": 2, "background": [0, 0.5, 1], "name": "fox"}
    check_arguments(OmegaConf.create({"scene": values}).scene)
    check_arguments(OmegaConf.create({"scene": {**values, "background": None, "downscale": 1.5}}).scene)


def test_what_another_package_refuses_is_the_users_mistake():
    cfg = OmegaConf.create({"share": {"_target_": "fractions.Fraction", "numerator": "many"}})
    with pytest.raises(InputError, match=r"share: is refused by fractions\.Fraction \(Invalid literal"):
        build(cfg.share)
