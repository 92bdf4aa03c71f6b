"""Two splats of one capture are enhanced and averaged; other captures and options for one splat are refused."""

from dataclasses import replace

import pytest
import torch

from gaussian_enhancer import enhance_folder
from gaussian_enhancer.cli.enhance import run
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import EnhancedView
from gaussian_enhancer.runs.second_splat import mean_views, refuse_other_views, second_configuration
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.renders import read_run
from support.job_config import job_config


def configured(*overrides: str):
    return job_config("enhance", *overrides, "runtime.progress=false", "runtime.threads=1")


def test_images_are_averaged_and_times_added() -> None:
    first = EnhancedView("a.png", torch.full((3, 2, 2), 0.2), 1.0, 2.0, ("b.png",), unchanged=True)
    second = EnhancedView("a.png", torch.full((3, 2, 2), 0.6), 10.0, 20.0, ("c.png",))
    (mean,) = mean_views([first], [second])
    assert mean == replace(first, image=mean.image, preparing=11.0, enhancing=22.0, unchanged=False)
    torch.testing.assert_close(mean.image, torch.full((3, 2, 2), 0.4))
    with pytest.raises(ValueError, match="shorter"):
        list(mean_views([first, first], [second]))


def test_the_job_averages_the_enhanced_views_of_both_splats(plane_run, other_plane_run, tmp_path) -> None:
    for name, inputs in (
        ("first", [f"run={plane_run}"]),
        ("second", [f"run={other_plane_run}"]),
        ("both", [f"run={plane_run}", f"second={other_plane_run}"]),
    ):
        assert run(configured(*inputs, "weights=lr_tiny", f"output={tmp_path / name}")) > 0
    names = sorted(path.name for path in (tmp_path / "first").iterdir())
    assert names == sorted(path.name for path in (tmp_path / "both").iterdir())
    for name in names:
        first, second, both = (read_photo(tmp_path / folder / name) for folder in ("first", "second", "both"))
        assert float((first - second).abs().mean()) > 0.01
        assert float((both - (first + second) / 2).abs().max()) <= 1 / 255
    files = enhance_folder(run=plane_run, second=other_plane_run, output=tmp_path / "python", device="cpu")
    assert [file.read_bytes() for file in files] == [(tmp_path / "both" / name).read_bytes() for name in names]


def test_a_run_of_two_splats_is_another_run(plane_run, other_plane_run, tmp_path) -> None:
    for second in ([], [f"second={other_plane_run}"]):
        run(configured(f"run={plane_run}", *second, "every=2", f"runs={tmp_path}"))
    assert len(list((tmp_path / "enhance").iterdir())) == 2


def test_other_views_are_refused(plane_run, other_plane_run) -> None:
    first, second = read_run(plane_run), read_run(other_plane_run)
    refuse_other_views(first, second)
    with pytest.raises(InputError, match=r"has other views than the first splat, view_004\.png"):
        refuse_other_views(first, replace(second, targets=second.targets[:1]))
    with pytest.raises(InputError, match="than the first splat, in another order"):
        refuse_other_views(first, replace(second, targets=second.targets[::-1]))
    moved = replace(second.targets[0], camera=second.references[0].camera)
    with pytest.raises(InputError, match=r"has another camera for view_000\.png"):
        refuse_other_views(first, replace(second, targets=(moved, *second.targets[1:])))
    with pytest.raises(InputError, match="has another camera"):
        refuse_other_views(first, replace(second, targets=(replace(moved, camera=None), *second.targets[1:])))


@pytest.mark.parametrize(
    ("overrides", "text"),
    [
        (["renders=folder"], "comes without a first splat"),
        (["run=a", "distil=true"], "comes with distil"),
        (["run=a", "budget_ms=100"], "comes with budget_ms"),
        (["run=a", "runtime.processes=2"], "comes with runtime.processes"),
    ],
)
def test_what_is_for_one_splat_is_refused(overrides, text) -> None:
    with pytest.raises(InputError, match=f"second: {text}"):
        second_configuration(configured(*overrides, "second=b"))


@pytest.mark.parametrize("form", ["run", "gaussians"])
def test_the_second_splat_takes_the_place_of_the_first(form) -> None:
    second = second_configuration(configured(f"{form}=a", "second=b"))
    assert (second[form], second.second) == ("b", None)


def test_a_second_splat_beside_a_folder_of_renders_is_refused_in_python(plane_run, other_plane_run, tmp_path) -> None:
    renders = plane_run / "test/ours_100/renders"
    with pytest.raises(InputError, match="second: comes without a first splat"):
        enhance_folder(renders=renders, second=other_plane_run, output=tmp_path / "none", device="cpu")
    assert not (tmp_path / "none").exists()
