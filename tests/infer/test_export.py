"""Networks as programs: the network's own images, at sizes and with numbers of references that were not traced."""

import dataclasses
from pathlib import Path

import pytest
import torch

from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.export import (
    Format,
    LoadedProgram,
    export_network,
    load_program,
    program_inputs,
    signature_of,
)
from gaussian_enhancer.infer.weights import Pretrained
from gaussian_enhancer.network.sif import SIF
from gaussian_enhancer.types import NetworkInput

TOLERANCE = 1e-4


def pretrained() -> Pretrained:
    """A small network with random weights in every layer: an untrained one returns the render."""
    torch.manual_seed(0)
    network = SIF(widths=(8, 8), blocks=(1, 1))
    for parameter in network.parameters():
        torch.nn.init.normal_(parameter, std=0.1)
    return Pretrained(network.eval(), ReferenceConfig(references=2, candidates=2), {"name": "small"})


def views(height: int, width: int, references: int) -> NetworkInput:
    rng = torch.Generator().manual_seed(height)

    def image(*shape: int) -> torch.Tensor:
        return torch.rand(1, *shape, height, width, generator=rng)

    shown = (image(references, 3), image(references, 1).round())
    depth = image(1) + 1
    return NetworkInput(image(3), *shown, depth, image(1), depth_unit(depth), reference_renders=image(references, 3))


@pytest.fixture(scope="module", params=["onnx", "torch_export"])
def program(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> LoadedProgram:
    form: Format = request.param
    path = tmp_path_factory.mktemp("programs") / {"onnx": "small.onnx", "torch_export": "small.pt2"}[form]
    signature, difference = export_network(pretrained(), path, form)
    assert difference < TOLERANCE
    assert signature == signature_of(pretrained())
    return load_program(path)


@pytest.mark.parametrize(("height", "width", "references"), [(40, 64, 2), (37, 51, 2), (64, 33, 1), (48, 48, 0)])
def test_a_program_enhances_as_its_network_does(
    program: LoadedProgram, height: int, width: int, references: int
) -> None:
    seen = views(height, width, references)
    if references == 0:
        seen = dataclasses.replace(seen, depth=None, depth_unit=None, alpha=None)
    with torch.no_grad():
        expected = pretrained().network(seen).clamp(0, 1)
    assert (expected - seen.render).abs().max() > 0.01
    enhanced = program.enhance(seen)
    assert enhanced.shape == expected.shape
    torch.testing.assert_close(enhanced, expected, atol=TOLERANCE, rtol=0)


def test_inputs_are_padded_to_the_stride_and_filled_up_with_unseen_references() -> None:
    signature = signature_of(pretrained(), references=3)
    inputs = program_inputs(views(37, 51, 1), signature)
    assert tuple(inputs) == signature.inputs
    assert inputs["references"].shape == (1, 3, 3, 40, 52)
    assert inputs["visibility"][:, 1:].abs().max() == 0


@pytest.mark.parametrize("references", [0, 9])
def test_a_number_of_references_out_of_range_is_refused(references: int) -> None:
    with pytest.raises(InputError, match=f"references: is {references}"):
        signature_of(pretrained(), references)


def test_what_a_program_cannot_take_is_refused() -> None:
    signature = signature_of(pretrained())
    with pytest.raises(InputError, match="references: are 3"):
        program_inputs(views(32, 32, 3), signature)
    with pytest.raises(InputError, match="reference_renders: is not given"):
        program_inputs(dataclasses.replace(views(32, 32, 1), reference_renders=None), signature)
    both = dataclasses.replace(views(32, 32, 1), depth_unit=None).map_images(lambda image, _: torch.cat([image, image]))
    with pytest.raises(InputError, match="one view at a time"):
        program_inputs(both, signature)


def test_a_file_of_another_kind_is_refused(tmp_path: Path) -> None:
    (tmp_path / "a.bin").touch()
    with pytest.raises(InputError, match="exported program"):
        load_program(tmp_path / "a.bin")


@pytest.mark.parametrize("name", ["a.onnx", "a.pt2"])
def test_a_file_that_does_not_exist_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="does not exist"):
        load_program(tmp_path / name)
