"""Export of enhancement networks as programs for other runtimes: ONNX, or torch.export's archive.

A program enhances one view without Python. Its inputs are the fields of `NetworkInput`, by name; images are float32
with sides that are multiples of the network's stride. The number of references is fixed: missing ones are images of
zeros with visibility 0, which have no effect. Axes: h height, w width, H = scale h, W = scale w.
"""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import torch
import torch.nn.functional as F
from jaxtyping import Float
from torch import Tensor, nn
from torch.export import Dim, ExportedProgram

from gaussian_enhancer.align.depth_normalisation import depth_unit
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.infer.weights import Pretrained
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.pyramid import pad_to_stride
from gaussian_enhancer.optional_library import optional_library
from gaussian_enhancer.types import NetworkInput

Format = Literal["onnx", "torch_export"]
ENDINGS: dict[str, str] = {"onnx": ".onnx", "torch_export": ".pt2"}
LONGEST_SIDE = 8192
"""Largest side in pixels of a program's renders."""
METADATA = "gaussian_enhancer"
"""Key of a program's metadata whose value is its `Signature` as JSON."""


@dataclass(frozen=True)
class Signature:
    """Inputs and output of an exported program.

    Args:
        name: name of the weights.
        stride: sides of the inputs are multiples of this number of pixels.
        references: number of references.
        scale: resolution of the output relative to the render's.
        inputs: names of the inputs, in order.
    """

    name: str
    stride: int
    references: int
    scale: int
    inputs: tuple[str, ...]


class Program(nn.Module):
    """A network whose arguments are tensors instead of a `NetworkInput`.

    Args:
        network: the network, in evaluation mode.
        inputs: fields of the network's input that are given, in order.
    """

    def __init__(self, network: Network, inputs: tuple[str, ...]) -> None:
        super().__init__()
        self.network, self.inputs = network, inputs

    def forward(self, *tensors: Tensor) -> Float[Tensor, "1 3 H W"]:
        """Enhance one view."""
        enhanced: Tensor = self.network(NetworkInput(**dict(zip(self.inputs, tensors, strict=True))))
        return enhanced.clamp(0, 1)


def signature_of(pretrained: Pretrained, references: int | None = None) -> Signature:
    """The signature of a program of these weights.

    Args:
        pretrained: weights.
        references: number of references; None means as many as in training.

    Raises:
        InputError: the number is out of range.
    """
    count = pretrained.reference_config.references if references is None else references
    if not 1 <= count <= 8:
        raise InputError("references", f"is {count}", "export a program of 1 to 8 references")
    names = [field.name for field in dataclasses.fields(NetworkInput)]
    if not pretrained.reference_config.fine:
        names.remove("fine_references")
    network = pretrained.network
    return Signature(str(pretrained.card.get("name", "unnamed")), network.stride, count, network.scale, tuple(names))


def program_inputs(views: NetworkInput, signature: Signature) -> dict[str, Tensor]:
    """Inputs of a program for one view: padded to the stride, with the program's number of references.

    Args:
        views: one view, of any size, with at most the program's number of references. Unknown depth becomes 0, which
            means no depth; unknown opacity becomes 1.
        signature: the program's signature.

    Raises:
        InputError: there are several views or too many references, or renders of the references are missing.
    """
    batch, count = views.references.shape[:2]
    if batch != 1:
        raise InputError("views", f"are {batch}", "give a program one view at a time")
    if count > signature.references:
        raise InputError("references", f"are {count}", f"the program takes {signature.references}")
    plane = views.render[:, :1]
    depth = torch.zeros_like(plane) if views.depth is None else views.depth
    views = dataclasses.replace(
        views,
        depth=depth,
        alpha=torch.ones_like(plane) if views.alpha is None else views.alpha,
        depth_unit=depth_unit(depth) if views.depth_unit is None else views.depth_unit,
    )
    tensors = {}
    for name in signature.inputs:
        value = getattr(pad_to_stride(views, signature.stride), name)
        if value is None:
            raise InputError(name, "is not given", "render the splat at the references' cameras as well")
        if name in ("references", "visibility", "reference_renders", "fine_references"):
            value = F.pad(value, (0, 0, 0, 0, 0, 0, 0, signature.references - count))
        tensors[name] = value.float().contiguous()
    return tensors


def example_inputs(signature: Signature, height: int = 96, width: int = 128, seed: int = 0) -> dict[str, Tensor]:
    """Random inputs of a program.

    Args:
        signature: the program's signature.
        height: height of the render, a multiple of the stride.
        width: width of the render, a multiple of the stride.
        seed: seed of the random numbers.
    """
    rng = torch.Generator().manual_seed(seed)

    def image(*shape: int) -> Tensor:
        return torch.rand(1, *shape, generator=rng)

    count = signature.references
    views = NetworkInput(
        image(3, height, width),
        image(count, 3, height, width),
        image(count, 1, height, width),
        image(1, height, width) + 1,
        image(1, height, width),
        reference_renders=image(count, 3, height, width),
        fine_references=image(count, 3, 4 * height, 4 * width) if "fine_references" in signature.inputs else None,
    )
    return program_inputs(views, signature)


def trace_network(pretrained: Pretrained, signature: Signature) -> ExportedProgram:
    """The network as torch.export's program, for renders with sides from 4 strides to `LONGEST_SIDE`.

    Args:
        pretrained: weights.
        signature: the program's signature.
    """
    stride = signature.stride
    # For smaller sides, torch.export would make programs for single sizes.
    bounds: dict[str, int] = {"min": 4, "max": LONGEST_SIDE // stride}
    height, width = (stride * Dim(name, **bounds) for name in ("height", "width"))
    inputs = example_inputs(signature, 6 * stride, 8 * stride)

    def sides(name: str, tensor: Tensor) -> dict[int, Any]:
        finer = 4 if name == "fine_references" else 1
        return {} if tensor.ndim < 3 else {tensor.ndim - 2: finer * height, tensor.ndim - 1: finer * width}

    program = Program(pretrained.network.eval(), signature.inputs)
    with torch.no_grad():
        return torch.export.export(
            program,
            tuple(inputs.values()),
            dynamic_shapes=(tuple(sides(name, tensor) for name, tensor in inputs.items()),),
        )


def export_network(
    pretrained: Pretrained, path: Path, form: Format = "onnx", references: int | None = None
) -> tuple[Signature, float]:
    """Write a network as a program, atomically, and compare the written program with the network.

    Args:
        pretrained: weights.
        path: file to write.
        form: "onnx" (needs the extra ``export``) or "torch_export".
        references: number of references of the program; None means as many as in training.

    Returns:
        The program's signature, and the largest difference of its output from the network's, on random inputs of
        another size than those of the trace.

    Raises:
        InputError: the format is unknown, its packages are missing, or the file cannot be written.
    """
    if form not in ENDINGS:
        raise InputError("format", f"is {form!r}", f"choose one of {', '.join(ENDINGS)}")
    if form == "onnx":
        require_onnx()
    signature = signature_of(pretrained, references)
    program = trace_network(pretrained, signature)
    metadata = json.dumps(dataclasses.asdict(signature))
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary:
        if form == "onnx":
            _write_onnx(program, signature, metadata, temporary)
        else:
            torch.export.save(program, temporary, extra_files={METADATA: metadata})
    inputs = example_inputs(signature, 4 * signature.stride, 7 * signature.stride, seed=1)
    with torch.no_grad():
        expected = Program(pretrained.network, signature.inputs)(*inputs.values())
    return signature, float((load_program(path)(inputs) - expected).abs().max())


def require_onnx() -> None:
    """Refuse if a package of the extra ``export`` is missing.

    Raises:
        InputError: a package cannot be imported.
    """
    for name in ("onnx", "onnxscript", "onnxruntime"):
        optional_library(name, "format=onnx", "export")


def _write_onnx(program: ExportedProgram, signature: Signature, metadata: str, path: Path) -> None:
    converted = torch.onnx.export(
        program, dynamo=True, input_names=list(signature.inputs), output_names=["enhanced"], verbose=False
    )
    assert converted is not None
    converted.model.metadata_props[METADATA] = metadata
    converted.save(str(path))


class LoadedProgram:
    """A program that was read from a file.

    Args:
        signature: the program's signature.
        run: function from tensors by name to the enhanced image.
    """

    def __init__(self, signature: Signature, run: Any) -> None:
        self.signature, self._run = signature, run

    def __call__(self, inputs: Mapping[str, Tensor]) -> Float[Tensor, "1 3 H W"]:
        """Enhance one view, given the result of `program_inputs`."""
        result: Tensor = self._run({name: inputs[name] for name in self.signature.inputs})
        return result

    def enhance(self, views: NetworkInput) -> Float[Tensor, "1 3 H W"]:
        """Enhance one view of any size with at most the program's number of references.

        Raises:
            InputError: there are several views or too many references, or renders of the references are missing.
        """
        height, width = (self.signature.scale * side for side in views.render.shape[-2:])
        return self(program_inputs(views, self.signature))[..., :height, :width]


def load_program(path: Path) -> LoadedProgram:
    """Read a program: ``.onnx`` runs in onnxruntime on the CPU, ``.pt2`` in torch.

    A ``.pt2`` archive can run code; read only those that you wrote.

    Raises:
        InputError: the file does not exist, is of neither kind, or was not written by `export_network`.
    """
    if not path.is_file():
        raise InputError(path, "does not exist", "name a file that the job export wrote")
    if path.suffix == ENDINGS["onnx"]:
        require_onnx()
        import onnxruntime

        session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
        metadata = session.get_modelmeta().custom_metadata_map.get(METADATA)

        def run(inputs: Mapping[str, Tensor]) -> Tensor:
            input_names = {value.name for value in session.get_inputs()}
            arrays = {name: value.numpy() for name, value in inputs.items() if name in input_names}
            return torch.from_numpy(session.run(None, arrays)[0])

    elif path.suffix == ENDINGS["torch_export"]:
        files = {METADATA: ""}
        module = torch.export.load(path, extra_files=files).module()
        metadata = files[METADATA]

        def run(inputs: Mapping[str, Tensor]) -> Tensor:
            with torch.no_grad():
                result: Tensor = module(*inputs.values())
            return result

    else:
        raise InputError(path, "is no exported program", "give a file that ends in .onnx or .pt2")
    if not metadata:
        raise InputError(path, "does not say what it takes", "export it again with gaussian-enhancer export")
    values = json.loads(metadata)
    return LoadedProgram(Signature(**{**values, "inputs": tuple(values["inputs"])}), run)
