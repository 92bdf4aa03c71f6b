"""Weights on disk: safetensors in half precision, with the design as plain values and nothing that names code.

The file's metadata holds JSON under ``design`` (the parameters of the network), ``reference_config`` (how references
are chosen and aligned) and ``card`` (where the weights come from). Kinds of stages are looked up in closed tables.
"""

import dataclasses
import inspect
import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args, get_origin

from torch import Tensor, nn

from gaussian_enhancer.align.alignment import Reprojected, Unwarped, Warp
from gaussian_enhancer.align.references import ReferenceConfig
from gaussian_enhancer.checkpoint import (
    REMEDY,
    build_and_load,
    check_whole_number,
    find_checkpoint,
    parse_metadata,
    read_checkpoint,
    write_checkpoint,
)
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.change_confidence import ChangeConfidence
from gaussian_enhancer.network.catalogue import NetworkCatalogue
from gaussian_enhancer.network.combine import Combined, Uncombined
from gaussian_enhancer.network.deform import Deformable, Unrefined
from gaussian_enhancer.network.depth_modulation import DepthModulated, Unmodulated
from gaussian_enhancer.network.fuse import ZERO_INITIALISED, Mean, Pair, Trust
from gaussian_enhancer.network.network import Network
from gaussian_enhancer.network.output_head import Gated, Residual

FORMAT = "gaussian-enhancer 2"
WARPS = (Reprojected, Unwarped)
STAGES: dict[str, tuple[type[Any], ...]] = {
    "refine": (Deformable, Unrefined),
    "fusion": (Trust, Mean, Pair),
    "modulation": (DepthModulated, Unmodulated),
    "combine": (Combined, Uncombined),
    "output": (Gated, Residual),
}
PARTS = ("first", "second")
"""Parameters of a network that are networks."""
MAX_LIST_LENGTH = 6
"""Largest number of entries of a list in a design."""
LONGEST_WORD = 64
"""Largest number of characters of a text in a design."""
CONFIDENCE_PREFIX = "confidence."
"""Prefix of the names of a change confidence's tensors; the network's tensors have none."""
KINDS: dict[str, type[Any]] = {kind.__name__: kind for kinds in (*STAGES.values(), WARPS) for kind in kinds}


NETWORKS: Mapping[str, type[Network]] = NetworkCatalogue()


@dataclass(frozen=True)
class Pretrained:
    """What a weights file holds.

    Args:
        network: the network in evaluation mode, single precision, on the CPU.
        reference_config: how references were chosen and aligned in training.
        card: where the weights come from.
        confidence: predicts the shares of the network's change to apply; None if none was trained for these weights.
    """

    network: Network
    reference_config: ReferenceConfig
    card: dict[str, Any]
    confidence: ChangeConfidence | None = None

    @property
    def strength(self) -> float:
        """The share of the network's change that was best on validation runs, as the card states it; 1 by default.

        It is for use without `confidence`, which was trained on the whole change.

        Raises:
            InputError: the card states something that is no number.
        """
        value = self.card.get("strength", 1.0)
        if isinstance(value, bool) or not isinstance(value, int | float):
            name = f"weights {self.card.get('name', 'without a name')}"
            raise InputError(name, f"state strength {value!r}", "give strength= as a number")
        return float(value)


def save_weights(
    path: Path,
    network: Network,
    reference_config: ReferenceConfig,
    card: Mapping[str, Any],
    confidence: ChangeConfidence | None = None,
) -> None:
    """Write weights atomically, in half precision.

    Args:
        path: file to write, ending in .safetensors.
        network: the trained network.
        reference_config: how references were chosen and aligned in training.
        card: plain values that state where the weights come from.
        confidence: the trained change confidence, if there is one.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    metadata = {
        "format": FORMAT,
        "design": json.dumps(design_of(network)),
        "reference_config": json.dumps(reference_config_of(reference_config)),
        "card": json.dumps(dict(card)),
    }
    values = network.state_dict()
    if confidence is not None:
        metadata["confidence"] = json.dumps({"hidden": confidence.hidden})
        values |= {f"{CONFIDENCE_PREFIX}{name}": value for name, value in confidence.state_dict().items()}
    write_checkpoint(path, values, metadata)


def load_weights(source: str | Path) -> Pretrained:
    """Read weights.

    Args:
        source: a .safetensors file, or the name of shipped weights.

    Raises:
        InputError: there is no such file or name, or it is truncated, of another format or of another design.
    """
    path = find_checkpoint(source)
    tensors, metadata = read_checkpoint(path, FORMAT)
    design, config, card = (parse_metadata(metadata, name, path) for name in ("design", "reference_config", "card"))
    confidence_tensors = {
        name.removeprefix(CONFIDENCE_PREFIX): v for name, v in tensors.items() if name.startswith(CONFIDENCE_PREFIX)
    }
    tensors = {name: value for name, value in tensors.items() if not name.startswith(CONFIDENCE_PREFIX)}
    try:
        network = build_and_load(lambda: build_design(design), design, tensors, path)
        reference_config = build_reference_config(config)
        confidence = None
        if confidence_tensors:
            confidence = _confidence(confidence_tensors, parse_metadata(metadata, "confidence", path), path)
    except InputError:
        raise
    except (KeyError, TypeError, ValueError, AttributeError, ArithmeticError, RuntimeError) as error:
        raise InputError(path, f"describes a network that this version does not support ({error})", REMEDY) from error
    return Pretrained(network.eval(), reference_config, card, confidence)


def _confidence(tensors: Mapping[str, Tensor], design: Mapping[str, Any], path: Path) -> ChangeConfidence:
    hidden = check_whole_number(design["hidden"], 1, 1024)
    return build_and_load(lambda: ChangeConfidence(hidden), design, tensors, path).eval()


def design_of(network: Network) -> dict[str, Any]:
    """The plain values that describe a network, from which `build_design` builds it again."""
    return _plain_design(network.design)


def _plain_design(design: Mapping[str, Any]) -> dict[str, Any]:
    def plain(name: str, value: Any) -> Any:
        if name in PARTS:
            return _plain_design(value)
        return _plain_values(value) if name in STAGES else value

    return {name: plain(name, value) for name, value in design.items()}


def copy_values(network: Network, source: Network) -> None:
    """Copy the parameters of one network to another of the same design, to train it further.

    Modules that the source lacks and that have no effect before training (`ZERO_INITIALISED`) stay unchanged.

    Args:
        network: network that is changed.
        source: network whose parameters are copied.

    Raises:
        ValueError: the designs differ in anything else.
    """
    design, source_design, values = design_of(network), design_of(source), source.state_dict()
    compatible = _without_options(design, ZERO_INITIALISED) == _without_options(source_design, ZERO_INITIALISED)
    if not compatible or values.keys() - network.state_dict().keys():
        name = next(key for key in {**design, **source_design} if design.get(key) != source_design.get(key))
        raise ValueError(f"have {name} {source_design.get(name)!r}, where {design.get(name)!r} is to be trained")
    network.load_state_dict({**network.state_dict(), **values})


def _without_options(design: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    """A design without some options of its stages."""
    return {
        stage: {name: value for name, value in choice.items() if name not in names}
        if isinstance(choice, Mapping)
        else choice
        for stage, choice in design.items()
    }


def build_design(design: Mapping[str, Any]) -> Network:
    """Build the untrained network of a design.

    Raises:
        ValueError: a value is out of range or of an unknown kind.
    """
    values = dict(design)
    kind = NETWORKS.get(values.pop("network"))
    if kind is None:
        raise ValueError(f"network {design['network']!r}")
    parameters = inspect.signature(kind).parameters
    unknown = sorted(values.keys() - parameters.keys())
    if unknown:
        raise ValueError(f"network {design['network']!r} has no parameter {unknown[0]!r}")
    return kind(**{name: _value(name, value, parameters[name].annotation) for name, value in values.items()})


def require_saveable(network: Network) -> None:
    """Refuse a network that could be trained and saved but not loaded again, before the training begins.

    The network is rebuilt from its design as JSON; its parameters must have the same names and shapes.

    Raises:
        InputError: they differ, or the network cannot be rebuilt.
    """
    name = type(network).__name__
    try:
        rebuilt = build_design(json.loads(json.dumps(design_of(network))))
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        remedy = "put its file into gaussian_enhancer/network, give it plain parameters, and call describe(locals())"
        raise InputError("fusion", f"is a {name} that its weights could not describe ({error})", remedy) from error
    shapes, rebuilt_shapes = ({n: v.shape for n, v in x.state_dict().items()} for x in (network, rebuilt))
    if shapes != rebuilt_shapes:
        differing = sorted(set(shapes.items()) ^ set(rebuilt_shapes.items()))[0][0]
        received = f"is a {name} that is built otherwise from its own design, at {differing}"
        raise InputError("fusion", received, "describe every parameter that the layers depend on")


def _value(name: str, value: Any, annotation: Any) -> Any:
    """Convert a plain value to a parameter of a network, which must have the parameter's annotated type."""
    if name in PARTS:
        if "first" in value or "second" in value:
            raise ValueError(f"{name} is made of several networks itself")
        return build_design(value)
    if name in STAGES:
        return _part(value, STAGES[name])
    if get_origin(annotation) is Sequence:
        (entry,) = get_args(annotation)
        if not isinstance(value, list) or not 1 <= len(value) <= MAX_LIST_LENGTH:
            raise ValueError(f"{name} is {value!r}, no list of 1 to {MAX_LIST_LENGTH} entries")
        return [_scalar(name, item, entry) for item in value]
    return _scalar(name, value, annotation)


def _scalar(name: str, value: Any, annotation: Any) -> bool | int | float | str:
    """A truth value, a whole number from 0 to 1024, a finite number, or a short word."""
    if annotation is bool and isinstance(value, bool):
        return value
    if annotation is int:
        return check_whole_number(value, 0, 1024)
    if annotation is float and isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value):
        return float(value)
    if annotation is str and isinstance(value, str) and len(value) <= LONGEST_WORD:
        return value
    raise ValueError(f"{name} is {value!r}, where the network takes {getattr(annotation, '__name__', annotation)}")


def reference_config_of(reference_config: ReferenceConfig) -> dict[str, Any]:
    """The plain values of a reference configuration."""
    counts = {"references": reference_config.references, "candidates": reference_config.candidates}
    # The default is left out, so that samples and weights from before this field keep their names.
    fine = {"fine": True} if reference_config.fine else {}
    return {"warp": _plain_values(reference_config.warp), **counts, **fine}


def build_reference_config(values: Mapping[str, Any]) -> ReferenceConfig:
    """The reference configuration of plain values.

    Raises:
        ValueError: a value is out of range or of an unknown kind.
    """
    warp: Warp = _part(values["warp"], WARPS)
    counts = check_whole_number(values["references"], 0, 8), check_whole_number(values["candidates"], 0, 1000)
    fine = values.get("fine", False)
    if not isinstance(fine, bool):
        raise ValueError(f"fine is {fine!r}")
    return ReferenceConfig(warp, *counts, fine)


def _plain_values(part: Any) -> dict[str, Any]:
    if KINDS.get(type(part).__name__) is not type(part):
        raise TypeError(f"{type(part).__name__} is no part that weights can name")
    return {"kind": type(part).__name__, **dataclasses.asdict(part)}


def _part(values: Mapping[str, Any], kinds: tuple[type[Any], ...]) -> Any:
    """Build an object of one of the given kinds from its plain values, which include the name of the kind."""
    values = dict(values)
    kind = KINDS.get(values.pop("kind"))
    if kind not in kinds or kind is None:
        raise ValueError(f"kind is none of {', '.join(k.__name__ for k in kinds)}")
    for name, value in values.items():
        is_plain = value is None or isinstance(value, bool | int | float | str)
        if not is_plain or not (isinstance(value, str) or math.isfinite(value or 0)):
            raise ValueError(f"{name} is {value!r}")
    return kind(**values)


def count_parameters(network: nn.Module) -> int:
    """Number of trainable values."""
    return sum(parameter.numel() for parameter in network.parameters())
