"""Weights on disk: safetensors in half precision, with the design as plain values and nothing that names code.

The file's metadata holds JSON under ``design`` (what the network is built from), ``preparation`` (how references
are brought to it) and ``card`` (where the weights come from). Kinds of parts are looked up in closed tables.
"""

import dataclasses
import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import nn

from gaussian_enhancer.enhance.alignment import Reprojected, Unwarped, Warp
from gaussian_enhancer.enhance.deform import Deformable, Unrefined
from gaussian_enhancer.enhance.fuse import Mean, Trust
from gaussian_enhancer.enhance.modulate import DepthModulated, Unmodulated
from gaussian_enhancer.enhance.prepare import Preparation
from gaussian_enhancer.enhance.sif import SIF
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file

FORMAT = "gaussian-enhancer 1"
SHIPPED = Path(__file__).resolve().parents[1] / "weights"
KINDS: dict[str, type[Any]] = {
    kind.__name__: kind
    for kind in (Deformable, Unrefined, Trust, Mean, DepthModulated, Unmodulated, Reprojected, Unwarped)
}
WARPS = (Reprojected, Unwarped)
STAGES = {"refine": (Deformable, Unrefined), "fusion": (Trust, Mean), "modulation": (DepthModulated, Unmodulated)}


@dataclass(frozen=True)
class Pretrained:
    """What a weights file holds.

    Args:
        network: in evaluation mode, single precision, on the CPU.
        preparation: how references were brought to it in training.
        card: where the weights come from.
    """

    network: SIF
    preparation: Preparation
    card: dict[str, Any]


def save_weights(path: Path, network: SIF, preparation: Preparation, card: Mapping[str, Any]) -> None:
    """Write weights, whole or not at all, in half precision.

    Args:
        path: file to write, ending in .safetensors.
        network: what was trained.
        preparation: how its references were prepared.
        card: plain values that say where the weights come from.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().half().contiguous() for name, value in network.state_dict().items()}
    metadata = {
        "format": FORMAT,
        "design": json.dumps(design_of(network)),
        "preparation": json.dumps(preparation_of(preparation)),
        "card": json.dumps(dict(card)),
    }
    with whole_file(path) as temporary:
        temporary.write_bytes(save(tensors, metadata))


def load_weights(source: str | Path) -> Pretrained:
    """Read weights.

    Args:
        source: a .safetensors file, or the name of weights in the package.

    Raises:
        InputError: there is no such file or name, or it is truncated, of another format or of another design.
    """
    path = find_weights(source)
    tensors, metadata = _read(path)
    try:
        network = build_design(json.loads(metadata["design"]))
        preparation = build_preparation(json.loads(metadata["preparation"]))
        card = json.loads(metadata["card"])
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(path, f"describes no network that this version knows ({error})", _MEND) from error
    expected = {name: value.shape for name, value in network.state_dict().items()}
    found = {name: value.shape for name, value in tensors.items()}
    if expected != found:
        odd = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(path, f"does not fit its own design at {odd}", _MEND)
    if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
        raise InputError(path, "holds values that are not finite", _MEND)
    network.load_state_dict({name: value.float() for name, value in tensors.items()})
    return Pretrained(network.eval(), preparation, card)


def find_weights(source: str | Path) -> Path:
    """The file that a path or a shipped name stands for."""
    path = Path(source)
    shipped = SHIPPED / f"{source}.safetensors"
    if path.is_file():
        return path
    if path.name == str(source) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise InputError(f"weights {source}", "is neither a file nor a shipped name", f"name a file, or one of: {names}")


def design_of(network: SIF) -> dict[str, Any]:
    """The plain values that a network is built from."""
    values = {"widths": list(network.widths), "blocks": list(network.blocks), "encoder_blocks": network.encoder_blocks}
    return {"network": "SIF", **values, **{stage: _plain(part) for stage, part in network.choices.items()}}


def build_design(design: Mapping[str, Any]) -> SIF:
    """The network of a design, untrained.

    Raises:
        ValueError: a value is out of range or of an unknown kind.
    """
    if design["network"] != "SIF":
        raise ValueError(f"network {design['network']!r}")
    widths, blocks = ([_whole(n, 1, 1024) for n in design[key]] for key in ("widths", "blocks"))
    if not 1 <= len(widths) <= 6 or len(widths) != len(blocks):
        raise ValueError(f"{len(widths)} widths and {len(blocks)} blocks")
    parts = {stage: _part(design[stage], kinds) for stage, kinds in STAGES.items()}
    return SIF(widths, blocks, _whole(design["encoder_blocks"], 0, 64), **parts)


def preparation_of(preparation: Preparation) -> dict[str, Any]:
    """The plain values of a preparation."""
    counts = {"references": preparation.references, "candidates": preparation.candidates}
    return {"warp": _plain(preparation.warp), **counts}


def build_preparation(values: Mapping[str, Any]) -> Preparation:
    """The preparation of plain values.

    Raises:
        ValueError: a value is out of range or of an unknown kind.
    """
    warp: Warp = _part(values["warp"], WARPS)
    return Preparation(warp, _whole(values["references"], 0, 8), _whole(values["candidates"], 0, 1000))


_MEND = "get the weights again, or train them with this version"


def _read(path: Path) -> tuple[dict[str, torch.Tensor], dict[str, str]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(str(path), framework="pt") as file:
            metadata = file.metadata() or {}
            tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        received = f"is no whole safetensors file ({path.stat().st_size} bytes: {error})"
        raise InputError(path, received, _MEND) from error
    if metadata.get("format") != FORMAT:
        raise InputError(path, f"has format {metadata.get('format')!r}", f"give weights of format {FORMAT!r}")
    return tensors, metadata


def _plain(part: Any) -> dict[str, Any]:
    if KINDS.get(type(part).__name__) is not type(part):
        raise TypeError(f"{type(part).__name__} is no part that weights can name")
    return {"kind": type(part).__name__, **dataclasses.asdict(part)}


def _part(values: Mapping[str, Any], kinds: tuple[type[Any], ...]) -> Any:
    """A part from its kind, one of a closed set, and plain numbers."""
    values = dict(values)
    kind = KINDS.get(values.pop("kind"))
    if kind not in kinds or kind is None:
        raise ValueError(f"kind is none of {', '.join(k.__name__ for k in kinds)}")
    for name, value in values.items():
        if not (value is None or isinstance(value, bool | int | float)) or not math.isfinite(value or 0):
            raise ValueError(f"{name} is {value!r}")
    return kind(**values)


def _whole(value: Any, low: int, high: int) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{value!r} is no whole number from {low} to {high}")
    return value


def count_parameters(network: nn.Module) -> int:
    """Number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters())
