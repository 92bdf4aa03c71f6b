"""Safe opening of scenes from a run's stored configuration: an allow-list of loaders, with validated argument types.

A run's folder may come from an untrusted source. The loader named in its ``config.yaml`` is therefore looked up in a
table and never imported, and no class named there is instantiated.
"""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from pydantic import ConfigDict, TypeAdapter, ValidationError, validate_call

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.input_files import read_yaml
from gaussian_enhancer.scene.capture import open_capture
from gaussian_enhancer.scene.colmap import load_colmap
from gaussian_enhancer.scene.opensfm import load_opensfm
from gaussian_enhancer.scene.procedural import procedural_scene
from gaussian_enhancer.scene.procedural.imperfections import Imperfections
from gaussian_enhancer.scene.published import load_published
from gaussian_enhancer.scene.scene import Scene
from gaussian_enhancer.scene.splits import Split
from gaussian_enhancer.scene.transforms import load_nerf_synthetic, load_transforms

LARGEST = 2**20
"""Maximum size of a configuration file in bytes; a run's has a few thousand."""

LOADERS: Mapping[str, Callable[..., Scene]] = {
    "gaussian_enhancer.scene.capture.open_capture": open_capture,
    "gaussian_enhancer.scene.colmap.load_colmap": load_colmap,
    "gaussian_enhancer.scene.opensfm.load_opensfm": load_opensfm,
    "gaussian_enhancer.scene.procedural.procedural_scene": procedural_scene,
    "gaussian_enhancer.scene.published.load_published": load_published,
    "gaussian_enhancer.scene.transforms.load_nerf_synthetic": load_nerf_synthetic,
    "gaussian_enhancer.scene.transforms.load_transforms": load_transforms,
}
"""The loaders that a configuration on disk may name."""

_PARTS: Mapping[str, type] = {"split": Split, "imperfections": Imperfections}
"""Arguments stored as mappings, and the dataclass that each is converted to."""


def read_scene_values(file: Path) -> dict[str, Any]:
    """Read the values below ``scene`` in a run's ``config.yaml`` as plain data.

    Args:
        file: path of the run's configuration.

    Raises:
        InputError: the file is missing, too large or not valid YAML, or has no mapping ``scene``.
    """
    if not file.is_file():
        raise InputError(file, "does not exist", "give a run that `fit` made, or the scene with scene=")
    if file.stat().st_size > LARGEST:
        raise InputError(file, f"has {file.stat().st_size} bytes", f"a run's configuration has at most {LARGEST}")
    content = read_yaml(file)
    scene = content.get("scene") if isinstance(content, dict) else None
    if not isinstance(scene, dict):
        raise InputError(file, "names no scene", "give a run that `fit` made")
    return scene


def scene_from_values(values: Mapping[str, Any]) -> Scene:
    """Open the scene described by plain values.

    Args:
        values: ``_target_``, a key of `LOADERS`, and the loader's arguments: numbers, strings, lists of numbers, and
            mappings for the arguments in `_PARTS`.

    Raises:
        InputError: the loader is not in `LOADERS`, an argument is unknown or of the wrong type, or the loader refuses
            the scene.
    """
    name = values.get("_target_")
    loader = LOADERS.get(name) if isinstance(name, str) else None
    if loader is None:
        loader_names = ", ".join(sorted(target.rsplit(".", 1)[1] for target in LOADERS))
        received = f"is {name!r} in a stored configuration"
        raise InputError("scene._target_", received, f"scenes are opened by {loader_names}")
    arguments = {str(key): _argument(str(key), value) for key, value in values.items() if key != "_target_"}
    validated_loader = validate_call(config=ConfigDict(strict=True, arbitrary_types_allowed=True))(loader)
    try:
        return validated_loader(**arguments)
    except ValidationError as error:
        raise _to_input_error("scene", error) from None


def _argument(name: str, value: Any) -> Any:
    if name in _PARTS and value is not None:
        return _part(name, value)
    if name == "background" and isinstance(value, list):
        return tuple(float(c) if isinstance(c, int) else c for c in value)
    return value


def _part(name: str, value: Any) -> Any:
    kind = _PARTS[name]
    path = f"{kind.__module__}.{kind.__qualname__}"
    if not isinstance(value, dict) or value.get("_target_", path) != path:
        raise InputError(f"scene.{name}", f"is {value!r} in a stored configuration", f"it is a mapping of {path}")
    try:
        return TypeAdapter(kind).validate_python({k: v for k, v in value.items() if k != "_target_"}, strict=False)
    except ValidationError as error:
        raise _to_input_error(f"scene.{name}", error) from None


def _to_input_error(subject: str, error: ValidationError) -> InputError:
    """An `InputError` for users made of pydantic's first error."""
    first_error = error.errors(include_url=False)[0]
    location = ".".join([subject, *map(str, first_error["loc"])])
    received = repr(first_error.get("input"))[:80]
    return InputError(location, f"is {received}: {first_error['msg'].lower()}", "give the run as `fit` wrote it")
