"""Saving and loading of stage 2's weights, and construction of second stages from them."""

import dataclasses
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from gaussian_enhancer.checkpoint import (
    REMEDY,
    build_and_load,
    check_whole_number,
    find_checkpoint,
    parse_metadata,
    read_checkpoint,
    write_checkpoint,
)
from gaussian_enhancer.degrade.generative.diffusion import Sampler
from gaussian_enhancer.degrade.generative.second_stage import (
    DiffusedGenerator,
    FactorDesign,
    FactorModel,
    PairedGenerator,
    PairedOrDiffusedGenerator,
)
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.types import fastest_dtype

FORMAT = "gaussian-enhancer simulator 1"


@dataclass(frozen=True)
class PretrainedModel:
    """Contents of a file of stage 2's weights.

    Args:
        model: networks in evaluation mode, in single precision, on the CPU.
        card: origin of the weights.
    """

    model: FactorModel
    card: dict[str, Any]


def save_model(path: Path, model: FactorModel, card: Mapping[str, Any]) -> None:
    """Write stage 2's weights with their design and card.

    Args:
        path: file to write, ending in .safetensors.
        model: trained networks.
        card: plain values that describe the origin of the weights.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    design = {**dataclasses.asdict(model.design), "widths": list(model.design.widths)}
    write_checkpoint(
        path, model.state_dict(), {"format": FORMAT, "design": json.dumps(design), "card": json.dumps(dict(card))}
    )


def load_model(source: str | Path) -> PretrainedModel:
    """Read stage 2's weights.

    Args:
        source: a .safetensors file, or the name of weights in the package.

    Raises:
        InputError: there is no such file or name, or the file is truncated, or has another format or design.
    """
    path = find_checkpoint(source)
    tensors, metadata = read_checkpoint(path, FORMAT)
    design, card = (parse_metadata(metadata, name, path) for name in ("design", "card"))
    try:
        model = build_and_load(lambda: FactorModel(_design(design)), design, tensors, path)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, ArithmeticError, RuntimeError) as error:
        raise InputError(path, f"describes a simulator that this version does not support ({error})", REMEDY) from error
    return PretrainedModel(model.eval(), card)


def paired(weights: str | Path = "simulator") -> PairedGenerator:
    """The second stage that extracts z from real renders, with weights from a file or from the package."""
    return PairedGenerator(load_model(weights).model)


def diffused(weights: str | Path = "simulator", sampler: Sampler | None = None) -> DiffusedGenerator:
    """The second stage that samples z, with weights from a file or from the package.

    Args:
        weights: a .safetensors file, or the name of weights in the package.
        sampler: sampler of z; None takes the default.
    """
    return DiffusedGenerator(load_model(weights).model, sampler, fastest_dtype())


def paired_or_diffused(weights: str | Path = "simulator", sampler: Sampler | None = None) -> PairedOrDiffusedGenerator:
    """The second stage that extracts z from real renders if they are given, and samples it otherwise.

    Args:
        weights: a .safetensors file, or the name of weights in the package.
        sampler: sampler of z; None takes the default.
    """
    return PairedOrDiffusedGenerator(load_model(weights).model, sampler, fastest_dtype())


def _design(values: Mapping[str, Any]) -> FactorDesign:
    counts = {name: check_whole_number(values[name], 0, 1024) for name in ("vector", "grid", "blocks")}
    widths = [check_whole_number(width, 1, 1024) for width in values["widths"]]
    code = {name: check_whole_number(values[name], 1, 1024) for name in ("code_width", "code_blocks")}
    if not 1 <= len(widths) <= 3:
        raise ValueError(f"{len(widths)} widths")
    return FactorDesign(**counts, widths=widths, **code, schedule=str(values["schedule"]))
