import dataclasses
from pathlib import Path

import pytest
import torch
from test_ssif_lr import small as small_ssif_lr

from gaussian_enhancer.align.alignment import Reprojected, Unwarped
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, build_network_input, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.colour_completion import complete_change
from gaussian_enhancer.infer.enhancer import SetEnhancer, choose_precision
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.plan import Rules, ViewPlan
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.infer.weights import Pretrained
from gaussian_enhancer.network.colour_clamping import clamp_to_references
from gaussian_enhancer.network.deform import Deformable
from gaussian_enhancer.network.encode import Encoder
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.renders import read_run
from gaussian_enhancer.types import Region
from support.failures import fill_disk
from support.networks import small_sif, trained, views


def test_untrained_network_returns_every_render(plane_run):
    rendered = read_run(plane_run)
    enhanced = list(SetEnhancer(small_sif(), ReferenceConfig())(rendered))
    assert [one.name for one in enhanced] == [view.name for view in rendered.targets]
    for one, view in zip(enhanced, rendered.targets, strict=True):
        assert view.read is not None
        assert torch.equal(one.image, view.read())
        assert len(one.references) == 3


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
def test_result_is_an_image(plane_run, precision):
    one = next(
        SetEnhancer(trained(), ReferenceConfig(references=1, candidates=2), precision=precision)(read_run(plane_run))
    )
    assert one.image.dtype == torch.float32
    assert 0 <= float(one.image.min()) <= float(one.image.max()) <= 1


def test_strength_scales_the_change(plane_run):
    rendered, network = read_run(plane_run), trained()
    none, half, full = (
        next(
            SetEnhancer(network, ReferenceConfig(), strength=s, precision="float32", colour_clamping=0)(rendered)
        ).image
        for s in (0.0, 0.5, 1.0)
    )
    assert rendered.targets[0].read is not None
    assert torch.equal(none, rendered.targets[0].read())
    inner = (full > 0) & (full < 1)
    torch.testing.assert_close(half[inner], ((none + full) / 2)[inner], rtol=0, atol=1e-5)
    with pytest.raises(InputError, match="strength"):
        SetEnhancer(network, ReferenceConfig(), strength=1.5)


def test_colours_stay_within_what_is_shown_where_references_are_warped(plane_run):
    rendered, network = read_run(plane_run), trained()
    (view, *_), pool = rendered.targets, ReferencePool(rendered.references)
    target = read_target(view)
    seen = build_network_input(target, ReferenceConfig().align(target, view, pool))

    def enhanced(clamping: int, completion: bool, strength: float = 1.0) -> torch.Tensor:
        options = {"precision": "float32", "colour_clamping": clamping, "colour_completion": completion}
        return SetEnhancer(network, ReferenceConfig(), strength=strength, **options).enhance(seen)

    free, near = enhanced(0, False), enhanced(3, False)
    assert torch.equal(near, clamp_to_references(free, seen, 3))
    completed = complete_change(near, seen)
    assert torch.equal(enhanced(3, True), completed.clamp(0, 1))
    assert torch.allclose(enhanced(3, True, 0.5), (0.5 * (seen.render + completed)).clamp(0, 1), atol=1e-6)
    assert not torch.equal(near, free)
    unwarped = ReferenceConfig(Unwarped())
    beside = build_network_input(target, unwarped.align(target, view, pool))
    free, near = (
        SetEnhancer(network, unwarped, precision="float32", colour_clamping=n).enhance(beside) for n in (0, 3)
    )
    assert torch.equal(near, free)
    with pytest.raises(InputError, match="colour_clamping"):
        SetEnhancer(network, ReferenceConfig(), colour_clamping=4)


def test_without_geometry_and_references_the_render_alone_is_enhanced(plane_run):
    rendered = read_run(plane_run)
    bare = [dataclasses.replace(view, camera=None, read_depth=None, read_alpha=None) for view in rendered.targets]
    rendered = dataclasses.replace(rendered, targets=tuple(bare))
    assert next(SetEnhancer(trained(), ReferenceConfig(references=0))(rendered)).references == ()
    with pytest.raises(InputError, match="no depth"):
        next(SetEnhancer(trained(), ReferenceConfig())(rendered))


def test_wrong_values_are_refused(plane_run):
    with pytest.raises(InputError, match="references"):
        ReferenceConfig(references=9)
    with pytest.raises(InputError, match="candidates"):
        ReferenceConfig(references=3, candidates=2)
    with pytest.raises(InputError, match="precision"):
        choose_precision("int8", torch.device("cpu"))
    empty = dataclasses.replace(read_run(plane_run), targets=())
    with pytest.raises(InputError, match="no render"):
        next(SetEnhancer(small_sif(), ReferenceConfig())(empty))


def test_images_are_written_whole_or_not_at_all(tmp_path, monkeypatch):
    image = torch.rand(3, 5, 7)
    write_image(tmp_path / "deep" / "a.png", image)
    torch.testing.assert_close(read_photo(tmp_path / "deep" / "a.png"), image, rtol=0, atol=0.5 / 255 + 1e-6)
    with pytest.raises(InputError, match="ends in"):
        write_image(tmp_path / "a.odd", image)

    monkeypatch.setattr("PIL.Image.Image.save", fill_disk)
    monkeypatch.setattr("pathlib.Path.write_bytes", fill_disk)
    for name in ("b.png", "b.jpg"):
        with pytest.raises(InputError, match="No space left"):
            write_image(tmp_path / name, image)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["deep"]


def many_targets(folder):
    """The run's targets three times over, under names of their own."""
    rendered = read_run(folder)
    again = [dataclasses.replace(view, name=f"{turn}-{view.name}") for turn in range(3) for view in rendered.targets]
    return dataclasses.replace(rendered, targets=tuple(again))


def count_references(network) -> list[int]:
    """Lists how many references each call of the network's encoders reads."""
    seen: list[int] = []
    for gather in (module for module in network.modules() if hasattr(module, "encode_reference")):
        assert isinstance(gather.encode_reference, Encoder)
        gather.encode_reference.stem.register_forward_pre_hook(lambda _, inputs: seen.append(len(inputs[0])))
    return seen


@pytest.mark.parametrize("precision", ["float32", "bfloat16"])
@pytest.mark.parametrize("make", [small_sif, small_ssif_lr])
def test_each_photo_is_encoded_once_and_the_result_is_the_same(plane_run, make, precision):
    rendered = many_targets(plane_run)
    network = trained(make, refine=Deformable(kernel=1))
    enhancer = SetEnhancer(network, ReferenceConfig(Unwarped(), 2, 2), precision=precision)
    seen = count_references(network)
    kept = list(enhancer(rendered))
    scales = len(network.encode(views()))
    used = {name for one in kept for name in one.references}
    del seen[-scales:]
    assert seen == [1] * (scales * len(used))
    assert len(used) < 2 * len(kept)
    enhancer.enhance = lambda views, names, kept, plain=enhancer.enhance: plain(views)
    plain = list(enhancer(rendered))
    assert sum(seen) == scales * (len(used) + 2 * len(kept))
    for one, other in zip(kept, plain, strict=True):
        # Processors may sum a batch of two in another order than a batch of one.
        torch.testing.assert_close(one.image, other.image, atol=1e-6 if precision == "float32" else 0, rtol=0)


def test_warped_references_and_tiles_are_encoded_anew(plane_run):
    rendered, network = many_targets(plane_run), trained()
    seen = count_references(network)
    warped = list(SetEnhancer(network, ReferenceConfig(Reprojected(), 2, 2))(rendered))
    assert seen == [2] * len(warped)
    seen.clear()
    enhancer = SetEnhancer(network, ReferenceConfig(Unwarped(), 2, 2), tile=64, halo=0)
    for _ in range(2):
        enhancer.enhance(views(height=64, width=96), ("a", "b"), ReferenceFeatures(network))
    assert seen == [2] * 4


def test_only_so_many_are_kept_and_sizes_and_knowledge_are_told_apart():
    network, seen = trained(), views(references=3)
    cache, calls = ReferenceFeatures(network, capacity=8), count_references(network)

    def grows(views, names) -> int:
        before = len(calls)
        features = cache(views, names)
        torch.testing.assert_close(features, network.encode(views), rtol=0, atol=1e-5)
        return len(calls) - before - 1

    assert [grows(seen, ("a", "b", "c")), grows(seen, ("a", "b", "c"))] == [3, 0]
    assert grows(dataclasses.replace(seen, reference_renders=seen.references / 2), ("a", "b", "c")) == 3
    assert grows(views(height=32, references=3), ("a", "b", "c")) == 3
    assert len(cache.entries) == 8
    assert grows(seen, ("a", "b", "c")) == 3
    assert cache(views(references=0), ()) is None


@pytest.mark.parametrize("value", [1e30, -1e30, float("nan")])
@pytest.mark.parametrize("field", ["render", "references", "alpha"])
def test_views_that_would_overflow_are_refused(field, value):
    seen = views()
    getattr(seen, field).flatten()[7] = value
    with pytest.raises(InputError, match=f"has 1 values that are not finite or beyond 1000 in its {field}"):
        SetEnhancer(trained(), ReferenceConfig(), precision="float32").enhance(seen)


@pytest.mark.parametrize("references", [0, 2])
def test_a_view_in_which_no_photo_is_visible_passes_through(plane_run, references):
    view = read_run(plane_run).targets[0]
    pool, target = ReferencePool(read_run(plane_run).references), read_target(view)
    seen = build_network_input(target, ReferenceConfig(references=references, candidates=2).align(target, view, pool))
    blind = dataclasses.replace(seen, visibility=0 * seen.visibility)
    guess, kept = (
        SetEnhancer(trained(), ReferenceConfig(), precision="float32", pass_through=passing)
        for passing in (False, True)
    )
    assert torch.equal(kept.enhance(blind), blind.render)
    assert not torch.equal(guess.enhance(blind), blind.render)
    if references:
        assert torch.equal(kept.enhance(seen), guess.enhance(seen))


class Constant(Network):
    """Returns an image whatever it sees."""

    def __init__(self, image: torch.Tensor) -> None:
        super().__init__()
        self.image = image

    def stages(self, views):
        return (self.image[None],)


@pytest.mark.parametrize("planned", [False, True])
@pytest.mark.parametrize("noise", [0.02, 0.3])
def test_a_view_that_the_splat_was_fitted_to_stays_as_rendered_where_that_is_nearer_to_its_photo(
    plane_run, planned, noise
):
    rendered = read_run(plane_run)
    own, held_out = rendered.references[0], rendered.targets[0]
    drawn = (own.read_photo() + noise * torch.randn(own.read_photo().shape)).clamp(0, 1)
    own = dataclasses.replace(own, read=lambda: drawn)
    fitted = dataclasses.replace(held_out, name=own.name, camera=own.camera, read=own.read)
    views = dataclasses.replace(
        rendered, targets=(fitted, held_out), references=(own, *rendered.references[1:]), own_depth=False
    )
    made = (own.read_photo() + 0.1 * torch.randn(drawn.shape)).clamp(0, 1)
    enhancer = SetEnhancer(Constant(made), ReferenceConfig(), precision="float32", colour_clamping=0, strength=0.9)
    planner = Planner(Rules(references="auto", small=0), ReferenceConfig(), views) if planned else None
    first, second = enhancer(views, planner)
    elsewhere = dataclasses.replace(fitted, camera=held_out.camera)
    moved, _ = enhancer(dataclasses.replace(views, targets=(elsewhere, held_out)), None)
    assert not moved.unchanged  # a view of the same name, but from another place
    assert first.unchanged is (noise < 0.1)
    assert torch.equal(first.image, drawn) is first.unchanged
    assert own.name not in first.references
    assert not second.unchanged
    renamed = dataclasses.replace(own, name=Path(own.name).with_suffix(".jpg").name)
    as_jpg = dataclasses.replace(views, references=(renamed, *views.references[1:]))
    assert next(iter(enhancer(as_jpg, None))).unchanged is first.unchanged


def test_a_users_wish_for_no_reference_is_not_taken_for_a_lack_of_them():
    pretrained = Pretrained(trained(), ReferenceConfig(), {})
    for wish, passing in ((None, True), (2, True), (0, False)):
        options = EnhancementOptions(max_references=wish)
        assert options.enhancer(pretrained, options.reference_config(pretrained, "surface")).pass_through is passing
    alone = Pretrained(trained(), ReferenceConfig(references=0, candidates=0), {})
    assert not EnhancementOptions().enhancer(alone, alone.reference_config).pass_through


def test_coverage_is_what_the_references_show(plane_run):
    rendered = read_run(plane_run)
    view = rendered.targets[0]
    pool = ReferencePool(rendered.references)
    aligned = ReferenceConfig().align(read_target(view), view, pool)
    one = next(SetEnhancer(small_sif(), ReferenceConfig(), keeps_coverage=True)(rendered, None, pool))
    assert one.coverage is not None
    torch.testing.assert_close(one.coverage, aligned.visibility.sum(0))
    assert 0 < float(one.coverage.max()) <= 3
    assert next(SetEnhancer(small_sif(), ReferenceConfig())(rendered)).coverage is None


def test_coverage_of_regions_is_that_of_the_whole_and_nothing_elsewhere(plane_run):
    rendered = read_run(plane_run)
    regions = (Region(8, 8, 24, 40),)
    planner = Planner(Rules(tiles="auto"), ReferenceConfig(), rendered)
    planner.plans = {view.name: ViewPlan(view.name, (48, 64), regions) for view in rendered.targets}
    enhancer = SetEnhancer(small_sif(), ReferenceConfig(), keeps_coverage=True)
    parts, whole = next(enhancer(rendered, planner)), next(enhancer(rendered))
    assert parts.coverage is not None
    assert whole.coverage is not None
    inside = torch.zeros(1, 48, 64, dtype=torch.bool)
    inside[:, 8:24, 8:40] = True
    assert float(parts.coverage[~inside].abs().max()) == 0
    assert float((parts.coverage - whole.coverage)[inside].abs().mean()) < 0.1
