"""What every registered network promises, whatever it is made of; see `gaussian_enhancer.network.network.Network`."""

import dataclasses
import json
from collections.abc import Callable

import pytest
import torch
import torch.nn.functional as F

from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.weights import NETWORKS, build_design, design_of, load_weights, save_weights
from gaussian_enhancer.network.deform import Deformable, Deformation
from gaussian_enhancer.network.depth_modulation import DepthModulation
from gaussian_enhancer.network.fuse import Mean, Pair, Trust
from gaussian_enhancer.network.network import CachesReferences, Network
from gaussian_enhancer.network.pyramid import upsample_bicubic
from gaussian_enhancer.types import NetworkInput
from support.networks import trained, views

SIZES = {"widths": (8, 8, 16), "blocks": (1, 1, 1)}
NULL = {"Identity", "Bicubic"}
"""Networks without parameters: they return the render, whatever is done to them."""
PAPER = {"PaperSIF", "PaperSSIFLR", "PaperSSIFSR"}
"""The paper's networks: they read two references at most, in their order."""


def small(name: str, **choices) -> Network:
    kind = NETWORKS[name]
    if name == "Cascade":
        network = kind(small("SSIFLR", **choices), small("SSIFSR", **choices))
    else:
        network = kind() if name in NULL else kind(**SIZES, **choices)
    assert isinstance(network, Network)
    return network.eval()


def full_views(height: int = 32, width: int = 48, *args, **kwargs) -> NetworkInput:
    """All that may be known, the unit of depth included, so that padding and cutting do not change it."""
    seen = views(height, width, *args, renders=True, **kwargs)
    return dataclasses.replace(seen, depth_unit=torch.full((len(seen.render),), 1.5))


def views_for(network: Network, *args, references: int = 2, **kwargs) -> NetworkInput:
    """What is known of the targets, with no more references than the network reads."""
    most = 2 if type(network).__name__ in PAPER else references
    return full_views(*args, fine=network.scale > 1, references=min(references, most), **kwargs)


def start(network: Network, seen: NetworkInput) -> torch.Tensor:
    """What an untrained network returns."""
    return upsample_bicubic(seen.render, network.scale)


def picked(seen: NetworkInput, order: list[int]) -> NetworkInput:
    """The views with these references alone, in this order."""

    def pick(images: torch.Tensor | None) -> torch.Tensor | None:
        return None if images is None else images[:, torch.tensor(order, dtype=torch.long)]

    changed = {n: pick(getattr(seen, n)) for n in ("references", "visibility", "reference_renders", "fine_references")}
    return dataclasses.replace(seen, **changed)


@pytest.fixture(params=sorted(NETWORKS))
def name(request) -> str:
    return request.param


@pytest.fixture(params=sorted(NETWORKS.keys() - NULL))
def learning(request) -> str:
    return request.param


def with_choices(name: str, **choices) -> dict[str, object]:
    """Those of the choices that the network has."""
    return {key: value for key, value in choices.items() if key in parameters(small(name))}


def parameters(network: Network) -> dict[str, object]:
    """What the network, or the first of several, is built from."""
    return {**network.design, **network.design.get("first", {})}


@pytest.mark.parametrize("size", [(1, 1), (3, 5), (48, 16), (33, 17)])
@pytest.mark.parametrize("references", [0, 1, 3, 8])
def test_untrained_returns_the_render(name, size, references):
    network = small(name, **with_choices(name, refine=Deformable(kernel=1)))
    seen = views_for(network, *size, references=references)
    for context in (torch.autocast("cpu", enabled=False), torch.autocast("cpu", torch.bfloat16)):
        with context, torch.no_grad():
            image = network(seen)
        assert image.dtype == torch.float32
        if network.scale == 1:
            assert torch.equal(image, seen.render)
        else:
            torch.testing.assert_close(image, start(network, seen), rtol=0, atol=1e-5)


def test_a_step_of_training_changes_the_result(learning):
    network = trained(small, learning)
    seen = views_for(network)
    assert (network(seen) - start(network, seen)).abs().mean() > 1e-3


@pytest.mark.parametrize("fusion", [Trust(), Trust(pooled=True), Mean()])
@pytest.mark.parametrize("unordered", sorted(NETWORKS.keys() - NULL - PAPER))
def test_order_of_references_changes_nothing(unordered, fusion):
    network = trained(small, unordered, **with_choices(unordered, fusion=fusion, refine=Deformable(kernel=1)))
    seen = views_for(network, references=3)
    torch.testing.assert_close(network(picked(seen, [2, 0, 1])), network(seen), rtol=0, atol=1e-5)


def test_order_matters_to_a_pair_and_a_third_is_refused():
    network = trained(small, "SIF", fusion=Pair())
    seen = full_views(references=3)
    pair = picked(seen, [0, 1])
    assert not torch.allclose(network(pair), network(picked(seen, [1, 0])), atol=1e-3)
    with pytest.raises(InputError, match="references"):
        network(seen)


@pytest.mark.parametrize("kind", sorted(PAPER))
def test_the_papers_networks_refuse_a_third_reference(kind):
    network = trained(small, kind)
    with pytest.raises(InputError, match="ask for 2, or choose mode=ours"):
        network(full_views(references=3, fine=network.scale > 1))


@pytest.mark.parametrize("fusion", [Trust(), Trust(pooled=True), Mean(), Pair()])
def test_missing_reference_equals_its_removal(learning, fusion):
    network = trained(small, learning, **with_choices(learning, fusion=fusion, refine=Deformable(kernel=1)))
    seen = views_for(network, references=2 if isinstance(fusion, Pair) else 3)
    every = list(range(seen.references.shape[1]))
    for missing, kept in (([1], [0, *every[2:]]), (every, [])):
        visibility = seen.visibility.clone()
        visibility[:, missing] = 0
        absent = dataclasses.replace(seen, visibility=visibility)
        torch.testing.assert_close(network(absent), network(picked(seen, kept)), rtol=0, atol=1e-5)


def test_references_are_used_or_ignored_as_the_network_says(learning):
    network = trained(small, learning)
    seen = views_for(network)
    with torch.no_grad():
        change = (network(seen) - network(picked(seen, []))).abs().max()
    assert (float(change) == 0) == (learning == "NAFNet")


def test_a_shift_of_everything_shifts_the_result(learning):
    """By the stride; in the middle, further from the borders than the network can tell them."""
    network = trained(small, learning)
    step, scale = network.stride, network.scale
    seen = views_for(network, height=32, width=320 + step)
    left = seen.map_images(lambda image, n: image[..., : n * 320])
    right = seen.map_images(lambda image, n: image[..., n * step :])
    with torch.no_grad():
        one, other = network(left), network(right)
    middle = slice(scale * (160 - step), scale * 160)
    shifted = slice(scale * (160 - 2 * step), scale * (160 - step))
    torch.testing.assert_close(one[..., middle], other[..., shifted], rtol=0, atol=2e-4)
    assert not torch.allclose(one[..., middle], other[..., middle], atol=1e-2)


@pytest.mark.parametrize("size", [(1, 1), (2, 3), (16, 48), (17, 33), (47, 31)])
@pytest.mark.parametrize("references", [0, 1, 8])
def test_any_size_and_any_number_of_references(name, size, references):
    network = trained(small, name, **with_choices(name, refine=Deformable(kernel=1)))
    image = network(views_for(network, *size, references=references))
    assert image.shape == (1, 3, network.scale * size[0], network.scale * size[1])
    assert bool(torch.isfinite(image).all())


def test_a_batch_is_its_samples(learning):
    network = trained(small, learning)
    seen = views_for(network, batch=2)
    images = {f.name: getattr(seen, f.name) for f in dataclasses.fields(seen)}
    for sample in range(2):
        alone = NetworkInput(**{n: None if v is None else v[sample : sample + 1] for n, v in images.items()})
        torch.testing.assert_close(network(alone), network(seen)[sample : sample + 1], rtol=0, atol=1e-5)


@pytest.mark.parametrize("kind", ["SIF", "SSIFLR", "SSIFSR", "Cascade"])
def test_huge_colours_of_hidden_references_do_not_overflow(kind):
    network = trained(small, kind)
    seen = views_for(network)
    hidden = dataclasses.replace(seen, visibility=torch.zeros_like(seen.visibility))
    huge = dataclasses.replace(
        hidden,
        references=hidden.references * 0 + 6e4,
        reference_renders=hidden.references * 0 - 6e4,
        fine_references=None if hidden.fine_references is None else hidden.fine_references * 0 + 6e4,
    )
    with torch.no_grad(), torch.autocast("cpu", torch.float16):
        torch.testing.assert_close(network(huge), network(hidden), rtol=0, atol=2e-3)


@pytest.mark.parametrize("absent", [("depth", "depth_unit"), ("alpha",), ("reference_renders",), ("fine_references",)])
def test_what_is_optional_may_be_absent(name, absent):
    network = trained(small, name)
    seen = dataclasses.replace(views_for(network), **dict.fromkeys(absent))
    image = network(seen)
    assert image.shape == start(network, seen).shape
    assert bool(torch.isfinite(image).all())


def test_scale_of_depth_does_not_matter(name):
    network = trained(small, name)
    seen = views_for(network)
    for factor in (1e-4, 1e4):
        scaled = dataclasses.replace(seen, depth=factor * seen.depth, depth_unit=factor * seen.depth_unit)
        torch.testing.assert_close(network(scaled), network(seen), rtol=0, atol=1e-4)
        alone = dataclasses.replace(seen, depth_unit=None)
        scaled = dataclasses.replace(scaled, depth_unit=None)
        torch.testing.assert_close(network(scaled), network(alone), rtol=0, atol=1e-4)


def test_gradients_reach_every_parameter(learning):
    network = trained(small, learning, **with_choices(learning, refine=Deformable(kernel=1)))
    network(views_for(network)).square().mean().backward()
    for parameter_name, parameter in network.named_parameters():
        assert parameter.grad is not None, parameter_name
        assert bool(torch.isfinite(parameter.grad).all()), parameter_name
        assert float(parameter.grad.abs().sum()) > 0, parameter_name


def test_gradients_reach_offsets_masks_and_depth_separately(learning):
    network = trained(small, learning, **with_choices(learning, refine=Deformable()))
    network(views_for(network)).square().mean().backward()
    aligned = [module for module in network.modules() if isinstance(module, Deformation)]
    modulated = [module for module in network.modules() if isinstance(module, DepthModulation)]
    assert bool(aligned) == ("refine" in parameters(network))
    # The paper's SSIF fuses depth's features in place of modulating by them.
    assert bool(modulated) == (bool(aligned) and learning not in PAPER - {"PaperSIF"})
    for module in aligned:
        moved = module.predict.weight.grad.abs().sum((1, 2, 3))
        split = 2 * module.groups * module.kernel**2
        assert float(moved[:split].sum()) > 0
        assert float(moved[split:].sum()) > 0
    for module in modulated:
        channels = module.modulate.out_channels // 2
        scale, shift = module.modulate.weight.grad.split(channels)
        assert float(scale.abs().sum()) > 0
        assert float(shift.abs().sum()) > 0
        assert float(module.stem.weight.grad.abs().sum()) > 0


def test_first_step_from_birth_moves_the_result(learning):
    """Zero-initialised layers must not wait for each other."""
    network = small(learning).train()
    seen = views_for(network)
    optimiser = torch.optim.SGD(network.parameters(), lr=0.1)
    photo = (start(network, seen) + 0.1).detach()
    F.mse_loss(network(seen), photo).backward()
    optimiser.step()
    with torch.no_grad():
        after = F.mse_loss(network(seen), photo)
    assert float(after) < 0.01


def test_bfloat16_stays_near(learning):
    network = trained(small, learning, **with_choices(learning, refine=Deformable(kernel=1)))
    seen = views_for(network)
    with torch.no_grad():
        exact = network(seen)
        with torch.autocast("cpu", torch.bfloat16):
            image = network(seen)
    assert bool(torch.isfinite(image).all())
    assert (image - exact).abs().mean() < 0.05 * (exact - start(network, seen)).abs().mean()


def test_stages_end_in_the_result(name):
    network = trained(small, name)
    seen = views_for(network, height=33, width=17)
    stages = network.stages(seen)
    assert torch.equal(stages[-1], network(seen))
    sides = [image.shape[-1] for image in stages]
    assert sides == sorted(sides)


@pytest.mark.parametrize("kind", sorted(n for n, kind in NETWORKS.items() if issubclass(kind, CachesReferences)))
def test_known_features_are_used_and_give_the_same(kind):
    network = trained(small, kind)
    seen = views_for(network)
    known = network.encode(seen)
    assert torch.equal(network(seen, known), network(seen))
    assert not torch.equal(network(seen, tuple(1.1 * features for features in known)), network(seen))


def test_design_and_weights_make_the_round_trip(name, tmp_path):
    network = trained(small, name, **with_choices(name, refine=Deformable(kernel=1), fusion=Mean()))
    design = json.loads(json.dumps(design_of(network)))
    assert design["network"] == name
    assert design_of(build_design(design)) == design_of(network)
    path = tmp_path / "network.safetensors"
    network.load_state_dict({key: value.half().float() for key, value in network.state_dict().items()})
    save_weights(path, network, ReferenceConfig(), {})
    seen = views_for(network)
    assert torch.equal(load_weights(path).network(seen), network(seen))


def test_every_network_is_named_by_its_class():
    kinds: list[Callable[..., Network]] = list(NETWORKS.values())
    assert [kind.__name__ for kind in kinds] == list(NETWORKS)
