"""Weights on disk: safetensors in half precision with plain metadata, and nothing that names code to run."""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path

import torch
from torch import Tensor, nn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file

SHIPPED = Path(__file__).resolve().parent / "weights"
MEND = "get the weights again, or train them with this version"


def write_checkpoint(path: Path, network: nn.Module, metadata: Mapping[str, str]) -> None:
    """Write a network's values in half precision, whole or not at all.

    Args:
        path: file to write, ending in .safetensors.
        network: whose values are kept, buffers included.
        metadata: plain text by name; ``format`` is mandatory and is asked for when the file is read.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().half().contiguous() for name, value in network.state_dict().items()}
    with whole_file(path) as temporary:
        temporary.write_bytes(save(tensors, {"format": metadata["format"], **metadata}))


def read_checkpoint(path: Path, form: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Values and metadata of a file.

    Args:
        path: of the file.
        form: what its metadata must state as ``format``.

    Raises:
        InputError: the file is truncated, no safetensors file, or of another format.
    """
    tensors, metadata = _read(path)
    if metadata.get("format") != form:
        raise InputError(path, f"has format {metadata.get('format')!r}", f"give weights of format {form!r}")
    return tensors, metadata


def _read(path: Path) -> tuple[dict[str, Tensor], dict[str, str]]:
    from safetensors import SafetensorError, safe_open

    try:
        with safe_open(str(path), framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        received = f"is no whole safetensors file ({path.stat().st_size} bytes: {error})"
        raise InputError(path, received, MEND) from error


def fill(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Give a network its values.

    Args:
        network: built from the file's own design.
        tensors: values by name.
        path: of the file, for messages.

    Raises:
        InputError: names or shapes differ, or a value is not finite.
    """
    expected = {name: value.shape for name, value in network.state_dict().items()}
    found = {name: value.shape for name, value in tensors.items()}
    if expected != found:
        odd = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(path, f"does not fit its own design at {odd}", MEND)
    if not all(bool(torch.isfinite(value).all()) for value in tensors.values()):
        raise InputError(path, "holds values that are not finite", MEND)
    network.load_state_dict({name: value.float() for name, value in tensors.items()})


def checkpoint_digest(path: Path) -> str:
    """SHA-256 of what weights do: design, preparation, values; not of their card, which says how they were made.

    One entry of the card does something, and counts where it is not 1: ``strength``, the share of the change to keep.

    Args:
        path: of the file.

    Raises:
        InputError: the file is truncated, no safetensors file, or its card is no mapping.
    """
    tensors, metadata = _read(path)
    told = {name: text for name, text in metadata.items() if name != "card"}
    try:
        strength = json.loads(metadata.get("card", "{}")).get("strength", 1)
    except (ValueError, AttributeError) as error:
        raise InputError(path, f"has a card that is no mapping ({error})", MEND) from error
    if strength != 1:
        told["strength"] = repr(strength)
    hashed = hashlib.sha256(json.dumps(told, sort_keys=True).encode())
    for name in sorted(tensors):
        hashed.update(f"{name} {tensors[name].dtype} {tuple(tensors[name].shape)}".encode())
        hashed.update(tensors[name].contiguous().numpy().tobytes())
    return hashed.hexdigest()


def find_checkpoint(source: str | Path) -> Path:
    """The file that a path or a shipped name stands for.

    Raises:
        InputError: it is neither.
    """
    path = Path(source)
    shipped = SHIPPED / f"{source}.safetensors"
    if path.is_file():
        return path
    if path.name == str(source) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED.glob("*.safetensors"))) or "none"
    raise InputError(f"weights {source}", "is neither a file nor a shipped name", f"name a file, or one of: {names}")


def whole_number(value: object, low: int, high: int) -> int:
    """A whole number within limits, as a design states it.

    Raises:
        ValueError: it is not.
    """
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{value!r} is no whole number from {low} to {high}")
    return value
