"""Controls as methods of studies: their known values, and what they refuse."""

from pathlib import Path

import pytest
import torch

from ablations.study.enhanced_views import enhanced_views
from ablations.study.methods import Average, average, load_enhancer, name_of, two_fits, two_steps
from gaussian_enhancer import enhance_folder
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import AUTO
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.metrics.records import Record, write_records
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import NetworkInput, quantise_8_bit
from support.synthetic_runs import write_plane_run


def test_weights_are_named_by_what_was_trained():
    assert name_of("lr_tiny") == "lr_tiny"
    assert name_of("own.safetensors") == "own"
    assert name_of("runs/train/row_sif-0123abcd/weights.safetensors") == "row_sif"


def test_the_average_weighs_references_by_visibility():
    render, references = torch.full((1, 3, 4, 4), 0.2), torch.full((1, 2, 3, 4, 4), 0.8)
    visibility = torch.zeros(1, 2, 1, 4, 4)
    visibility[..., 1], visibility[..., 2:] = 0.5, 1.0
    found = Average()(NetworkInput(render, references, visibility))
    for column, expected in enumerate((0.2, (0.2 + 0.8) / 2, (0.2 + 1.6) / 3, (0.2 + 1.6) / 3)):
        torch.testing.assert_close(found[..., column], torch.full((1, 3, 4), expected))
    empty = NetworkInput(render, references[:, :0], visibility[:, :0])
    assert torch.equal(Average()(empty), render)


def test_the_average_is_of_render_and_the_shipped_weights_references(plane_run):
    _, enhancer = average()(plane_run, 100)
    for one in enhanced_views(read_run(plane_run), {"average": enhancer}):
        result = one.results["average"]
        total = one.render + (result.aligned.visibility * result.aligned.references).sum(0)
        expected = total / (1 + result.aligned.visibility.sum(0))
        torch.testing.assert_close(result.image, expected.clamp(0, 1), atol=1e-6, rtol=0)


def fit_of(folder: Path, scene: str = "plush", **choices: object) -> Path:
    """A fit of a scene, made without fitting."""
    write_plane_run(folder, **choices)  # type: ignore[arg-type]
    write_records(folder / "records.jsonl", [Record("cost", folder.name, scene, "3dgs", "", "raw", {})])
    return folder


def test_two_fits_are_averaged(tmp_path):
    first, second = fit_of(tmp_path / "a"), fit_of(tmp_path / "b", seed=1)
    name, enhancer = two_fits([str(second)])(first, 100)
    assert name == "b"
    others = read_run(second).targets
    for one, other in zip(enhanced_views(read_run(first), {"two": enhancer}), others, strict=True):
        assert torch.equal(one.results["two"].image, (one.render + other.read()) / 2)
        assert one.results["two"].aligned.names == ()


def test_enhanced_views_of_two_fits_are_averaged(tmp_path):
    first, second = fit_of(tmp_path / "a"), fit_of(tmp_path / "b", seed=1)
    shipped = load_enhancer("lr_tiny", EnhancementOptions(), None)[1]
    _, both = two_fits([str(second)], shipped)(first, 100)
    sets = read_run(first), read_run(second)
    each = [[view.image for view in shipped(one, Planner(AUTO, shipped.reference_config, one))] for one in sets]
    for view, images in zip(enhanced_views(sets[0], {"two": both}), zip(*each, strict=True), strict=True):
        torch.testing.assert_close(view.results["two"].image, sum(images) / 2, atol=1e-6, rtol=0)


def test_two_steps_are_combined_as_by_the_job(tmp_path):
    fit = fit_of(tmp_path / "a", steps=(3000, 15000))
    files = enhance_folder(run=fit, output=tmp_path / "enhanced", device="cpu")
    _, both = two_steps("lr_tiny", None)(fit, 15000)
    assert not isinstance(both, SetEnhancer)
    for view, file in zip(enhanced_views(read_run(fit, 15000), {"both": both}), files, strict=True):
        assert torch.equal(quantise_8_bit(view.results["both"].image), read_photo(file))


def test_a_step_without_an_earlier_one_is_enhanced_alone(tmp_path):
    _, alone = two_steps("lr_tiny", None)(fit_of(tmp_path / "a", steps=(3000, 15000)), 3000)
    assert isinstance(alone, SetEnhancer)
    assert alone.ensemble


def test_second_fits_that_do_not_match_are_refused(tmp_path):
    first, second = fit_of(tmp_path / "a"), fit_of(tmp_path / "b", seed=1)
    with pytest.raises(InputError, match="no other fit of plush"):
        two_fits([str(first)])(first, 100)
    with pytest.raises(InputError, match="no other fit of plush"):
        two_fits([str(fit_of(tmp_path / "c", "banana"))])(first, 100)
    with pytest.raises(InputError, match="is of the scene plush"):
        two_fits([str(first), str(second)])
    with pytest.raises(InputError, match="names no fit"):
        two_fits([])
    with pytest.raises(InputError, match="no renders of step 50"):
        two_fits([str(second)])(first, 50)
    with pytest.raises(InputError, match=r"did not hold out view_004\.png"):
        two_fits([str(fit_of(tmp_path / "d", views=4))])(first, 100)
    _, small = two_fits([str(fit_of(tmp_path / "e", size=(24, 32)))])(first, 100)
    with pytest.raises(InputError, match="32x24 in the second fit, 64x48"):
        list(enhanced_views(read_run(first), {"two": small}))
