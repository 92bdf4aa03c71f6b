"""Weights on disk: safetensors in half precision with plain metadata, and nothing that names code to run."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import whole_file
from gaussian_enhancer.input_files import parse_json, refusal, refuse_larger, regular_file, shown

_N = TypeVar("_N", bound=nn.Module)
SHIPPED = Path(__file__).resolve().parent / "weights"
DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
WIDENED = 6
"""Times a file's size that its values take at most: as stored, in single precision twice, and in the network."""
MEND = "get the weights again, or train them with this version"


def write_checkpoint(path: Path, values: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write networks' values in half precision, whole or not at all.

    Args:
        path: file to write, ending in .safetensors.
        values: parameters and buffers by name.
        metadata: plain text by name; ``format`` is mandatory and is asked for when the file is read.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().half().contiguous() for name, value in values.items()}
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

    size = regular_file(path)
    refuse_larger(path, WIDENED * size, f"is {size} bytes long")
    try:
        with safe_open(str(path), framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise refusal(path, error) from error
        raise InputError(path, f"is no whole safetensors file ({size} bytes: {error})", MEND) from error


def described(metadata: Mapping[str, str], name: str, path: Path) -> dict[str, Any]:
    """What a file's metadata says under a name, which is JSON.

    Args:
        metadata: of the file.
        name: which of its texts.
        path: of the file, for messages.

    Raises:
        InputError: there is no such text, or it is no JSON object.
    """
    if name not in metadata:
        raise InputError(path, f"describes no {name}", MEND)
    value = parse_json(metadata[name], f"{path}: its {name}")
    if not isinstance(value, dict):
        raise InputError(path, f"has a {name} that is no mapping ({shown(value)})", MEND)
    return value


def build_filled(build: Callable[[], _N], design: Mapping[str, Any], tensors: Mapping[str, Tensor], path: Path) -> _N:
    """A network of a file's own design with its values, built only once its shapes are known to be the file's.

    The first one is built without memory, so that a design allocates no more than the file's own size allows.

    Args:
        build: makes the network.
        design: the plain values that it is made from.
        tensors: values by name.
        path: of the file, for messages.

    Raises:
        InputError: the design is deeper than the file's values, or see `fill`.
        KeyError, TypeError, ValueError: what ``build`` raises for a design that it does not know.
    """
    depth = _blocks(design)
    if depth > len(tensors):
        raise InputError(path, f"has a design of {depth} blocks but {len(tensors)} tensors", MEND)
    with torch.device("meta"):
        _refuse_misfit(build(), tensors, path)
    network = build()
    fill(network, tensors, path)
    return network


def _blocks(design: Any) -> int:
    """How many blocks a design asks for, each of which has values of its own."""
    if not isinstance(design, Mapping):
        return 0
    counts = [value for name, value in design.items() if name.endswith("blocks")]
    flat = [n for value in counts for n in (value if isinstance(value, list) else [value]) if isinstance(n, int)]
    return sum(flat) + sum(_blocks(value) for value in design.values())


def _refuse_misfit(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    expected = {name: value.shape for name, value in network.state_dict().items()}
    found = {name: value.shape for name, value in tensors.items()}
    if expected != found:
        odd = sorted(set(expected.items()) ^ set(found.items()))[0][0]
        raise InputError(path, f"does not fit its own design at {odd}", MEND)


def fill(network: nn.Module, tensors: Mapping[str, Tensor], path: Path) -> None:
    """Give a network its values.

    Args:
        network: built from the file's own design.
        tensors: values by name.
        path: of the file, for messages.

    Raises:
        InputError: names or shapes differ, or a value is no number or not finite.
    """
    _refuse_misfit(network, tensors, path)
    odd = sorted(str(value.dtype) for value in tensors.values() if value.dtype not in DTYPES)
    if odd:
        raise InputError(path, f"holds values of type {odd[0]}", MEND)
    values = {name: value.float() for name, value in tensors.items()}
    if not all(bool(torch.isfinite(value).all()) for value in values.values()):
        raise InputError(path, "holds values that are not finite", MEND)
    network.load_state_dict(values)


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
    strength = described(metadata, "card", path).get("strength", 1) if "card" in metadata else 1
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
    if not isinstance(source, str | Path):
        raise InputError("weights", f"is {shown(source)}", "name a file or shipped weights")
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
