import math
from functools import partial
from pathlib import Path

import pytest

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.plan import Rules
from gaussian_enhancer.scene.photos import downscaled_size
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.splat.fit.densify import Densification
from gaussian_enhancer.splat.fit.optimise import LearningRates
from gaussian_enhancer.splat.fit.plane_sweep import SweepSettings
from gaussian_enhancer.splat.fit.settings import FitSettings, Regularisation
from gaussian_enhancer.typed import check_plain


def test_the_defaults_are_of_their_types() -> None:
    FitSettings(snapshots=[0.25, 0.5], ssim_weight=1.0)
    Rules()


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        (FitSettings, "steps", 1.5),
        (FitSettings, "steps", math.nan),
        (FitSettings, "steps", "abc"),
        (FitSettings, "steps", None),
        (FitSettings, "ssim_weight", math.nan),
        (FitSettings, "ssim_weight", 1.5),
        (FitSettings, "seed", -1),
        (FitSettings, "snapshots", "abc"),
        (FitSettings, "snapshots", [math.nan]),
        (Regularisation, "opacity", math.inf),
        (Regularisation, "opacity", -0.1),
        (Densification, "growth", math.nan),
        (LearningRates, "means", "fast"),
        (SweepSettings, "planes", 9.5),
        (Split, "test_every", "abc"),
        (Rules, "share", "abc"),
    ],
)
def test_a_value_of_another_type_is_named(kind, name: str, value) -> None:
    settings = kind()
    object.__setattr__(settings, name, value)  # the tests' own shape checks would stop a constructor's argument
    with pytest.raises(InputError, match=rf"{name}(\.0)?: is .*; give "):
        settings.__post_init__()


@pytest.mark.parametrize(
    ("value", "kind", "message"),
    [
        (123, str | None, 'run: is 123; give text ("123"; on the command line \'"123"\') or null'),
        (1.5, str | Path, 'run: is 1.5; give text ("1.5"; on the command line \'"1.5"\')'),
        ([7], list[str], 'run.0: is 7; give text ("7"; on the command line \'"7"\')'),
        (True, str, "run: is True; give text"),
    ],
)
def test_a_name_of_digits_is_said_to_need_quotes(value, kind, message: str) -> None:
    with pytest.raises(InputError) as refusal:
        check_plain(value, kind, "run")
    assert str(refusal.value) == message


@pytest.mark.parametrize("value", ["abc", math.nan, None])
def test_downscale_is_a_number(value) -> None:
    unchecked = getattr(downscaled_size, "__wrapped__", downscaled_size)
    with pytest.raises(InputError, match="downscale: is"):
        unchecked(10, 10, value)


@pytest.mark.parametrize(
    ("name", "value"),
    [("tile", "abc"), ("strength", "abc"), ("temporal_smoothing", None), ("colour_clamping", math.nan)],
)
def test_an_enhancers_numbers_are_checked(name: str, value) -> None:
    unchecked = partial(getattr(SetEnhancer.__init__, "__wrapped__", SetEnhancer.__init__), object.__new__(SetEnhancer))
    with pytest.raises(InputError, match=f"{name}: is"):
        unchecked(None, ReferenceConfig(), **{name: value})
