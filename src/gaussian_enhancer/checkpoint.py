"""Read and write network weights as safetensors in half precision.

The metadata is plain text. Nothing in a file names code to be run.
"""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import Tensor, nn

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write
from gaussian_enhancer.input_files import abbreviate, parse_json, refuse_larger, regular_file, to_input_error

_N = TypeVar("_N", bound=nn.Module)
WEIGHTS = "weights.safetensors"
"""File of a training's weights in its run's folder."""
SHIPPED_FOLDER = Path(__file__).resolve().parent / "weights"
DTYPES = (torch.float16, torch.bfloat16, torch.float32, torch.float64)
MEMORY_GROWTH = 6
"""Most memory that loading takes, as a multiple of the file's size: as stored, in float32, and in the network."""
REMEDY = "get the weights again, or train them with this version"


def write_checkpoint(path: Path, values: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Write tensors of networks in half precision, atomically.

    Args:
        path: file to write, ending in .safetensors.
        values: parameters and buffers by name.
        metadata: plain text by name; ``format`` is mandatory and is checked when the file is read.

    Raises:
        InputError: the disk is full or the folder cannot be written.
    """
    from safetensors.torch import save

    tensors = {name: value.detach().cpu().half().contiguous() for name, value in values.items()}
    with atomic_write(path) as temporary:
        temporary.write_bytes(save(tensors, {"format": metadata["format"], **metadata}))


def read_checkpoint(path: Path, form: str) -> tuple[dict[str, Tensor], dict[str, str]]:
    """Read tensors and metadata of a file.

    Args:
        path: the file.
        form: required value of ``format`` in the metadata.

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
    refuse_larger(path, MEMORY_GROWTH * size, f"is {size} bytes long")
    try:
        with safe_open(str(path), framework="pt") as file:
            return {name: file.get_tensor(name) for name in file.keys()}, file.metadata() or {}  # noqa: SIM118
    except (SafetensorError, OSError, ValueError) as error:
        if isinstance(error, OSError) and error.errno is not None:
            raise to_input_error(path, error) from error
        raise InputError(path, f"is no whole safetensors file ({size} bytes: {error})", REMEDY) from error


def parse_metadata(metadata: Mapping[str, str], name: str, path: Path) -> dict[str, Any]:
    """Parse an entry of a file's metadata, which is a JSON object.

    Args:
        metadata: the file's metadata.
        name: key of the entry.
        path: the file, named in errors.

    Raises:
        InputError: there is no such entry, or it is no JSON object.
    """
    if name not in metadata:
        raise InputError(path, f"describes no {name}", REMEDY)
    value = parse_json(metadata[name], f"{path}: its {name}")
    if not isinstance(value, dict):
        raise InputError(path, f"has a {name} that is no mapping ({abbreviate(value)})", REMEDY)
    return value


def build_and_load(build: Callable[[], _N], design: Mapping[str, Any], tensors: Mapping[str, Tensor], path: Path) -> _N:
    """Build the network that a file describes, and load the file's tensors into it.

    The network is first built on the meta device, which allocates no memory, and its shapes are compared with those of
    the file. So a design cannot allocate more memory than the file's size allows.

    Args:
        build: builds the network.
        design: the plain values that describe the network.
        tensors: parameters and buffers by name.
        path: the file, named in errors.

    Raises:
        InputError: the design has more blocks than the file has tensors, names or shapes differ, a tensor's type is
            none of `DTYPES`, or a value is not finite.
        KeyError, TypeError, ValueError: as raised by ``build`` for an unknown design.
    """
    depth = _blocks(design)
    if depth > len(tensors):
        raise InputError(path, f"has a design of {depth} blocks but {len(tensors)} tensors", REMEDY)
    with torch.device("meta"):
        expected = {name: value.shape for name, value in build().state_dict().items()}
    stored = {name: value.shape for name, value in tensors.items()}
    if expected != stored:
        mismatch = sorted(set(expected.items()) ^ set(stored.items()))[0][0]
        raise InputError(path, f"does not fit its own design at {mismatch}", REMEDY)
    unsupported = sorted(str(value.dtype) for value in tensors.values() if value.dtype not in DTYPES)
    if unsupported:
        raise InputError(path, f"holds values of type {unsupported[0]}", REMEDY)
    values = {name: value.float() for name, value in tensors.items()}
    if not all(bool(torch.isfinite(value).all()) for value in values.values()):
        raise InputError(path, "holds values that are not finite", REMEDY)
    network = build()
    network.load_state_dict(values)
    return network


def _blocks(design: Any) -> int:
    """Number of blocks in a design. Each block has at least one tensor of its own."""
    if not isinstance(design, Mapping):
        return 0
    values = [value for name, value in design.items() if name.endswith("blocks")]
    counts = [count for value in values for count in (value if isinstance(value, list) else [value])]
    nested = sum(_blocks(value) for value in design.values())
    return nested + sum(count for count in counts if isinstance(count, int))


def checkpoint_digest(path: Path) -> str:
    """SHA-256 of everything in a file of weights that affects the output: all tensors, and all metadata but the card.

    The card documents how the weights were made. Only its entry ``strength``, the share of the network's change that is
    applied, affects the output; it is included where it is not 1.

    Args:
        path: the file.

    Raises:
        InputError: the file is truncated, no safetensors file, or its card is no mapping.
    """
    tensors, metadata = _read(path)
    hashed_metadata = {name: text for name, text in metadata.items() if name != "card"}
    strength = parse_metadata(metadata, "card", path).get("strength", 1) if "card" in metadata else 1
    if strength != 1:
        hashed_metadata["strength"] = repr(strength)
    digest = hashlib.sha256(json.dumps(hashed_metadata, sort_keys=True).encode())
    for name in sorted(tensors):
        digest.update(f"{name} {tensors[name].dtype} {tuple(tensors[name].shape)}".encode())
        digest.update(tensors[name].contiguous().flatten().view(torch.uint8).numpy().tobytes())  # NumPy has no bfloat16
    return digest.hexdigest()


def find_checkpoint(source: str | Path) -> Path:
    """Resolve a path or the name of shipped weights to a file.

    Raises:
        InputError: the source is neither.
    """
    if not isinstance(source, str | Path):
        raise InputError("weights", f"is {abbreviate(source)}", "name a file or shipped weights")
    path = Path(source)
    shipped = SHIPPED_FOLDER / f"{source}.safetensors"
    if path.is_file():
        return path
    if path.name == str(source) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in SHIPPED_FOLDER.glob("*.safetensors"))) or "none"
    raise InputError(f"weights {source}", "is neither a file nor a shipped name", f"name a file, or one of: {names}")


def check_whole_number(value: object, low: int, high: int) -> int:
    """Return a value of a design that must be an integer from ``low`` to ``high``.

    Raises:
        ValueError: it is no such integer.
    """
    if not isinstance(value, int) or isinstance(value, bool) or not low <= value <= high:
        raise ValueError(f"{value!r} is no whole number from {low} to {high}")
    return value
