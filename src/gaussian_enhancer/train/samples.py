"""Prepared training tuples on disk: every reference is warped once, at full size.

A sample is one `.npy` of 8-bit planes (p h w), which is memory-mapped so that a crop reads only its own rows:
render 3, photo 3, alpha 1, inverse depth 2 (16 bits, high byte first), then for each reference colour 3, visibility 1
and the splat's own render of its view 3. Warping commutes with cropping and flipping, so that augmentation is local.
A training view, prepared for simulation alone, has its photo in place of its render: that was fitted to the photo.
Axes: p planes, h height, w width, r references.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.enhance.modulate import depth_unit, normalised_inverse_depth
from gaussian_enhancer.enhance.prepare import Pool, Preparation, read_target
from gaussian_enhancer.enhance.weights import preparation_of
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import save_array, unwritable, whole_file
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Batch, Views

LAYOUT = 5
FIXED = 9
EACH = 7
NEAREST = 4.0


@dataclass(frozen=True)
class Sample:
    """One prepared tuple.

    Args:
        name: set and view.
        path: of the planes.
        height: in pixels.
        width: in pixels.
        references: how many references it has.
        has_depth: whether depth is known.
        has_alpha: whether opacity is known.
        held_out: whether the render was not fitted to the photo, so that the two are a pair to learn from.
        has_reference_renders: whether the splat's own renders of the references' views are known.
    """

    name: str
    path: str
    height: int
    width: int
    references: int
    has_depth: bool
    has_alpha: bool
    held_out: bool = True
    has_reference_renders: bool = False

    def planes(self) -> np.ndarray:
        """The planes, mapped from the file."""
        return np.load(self.path, mmap_mode="r")


def prepare_samples(
    rendered: RenderedSet,
    preparation: Preparation,
    cache: Path,
    identity: str,
    workers: int = 2,
    progress: Callable[[], None] = lambda: None,
    held_out: bool = True,
) -> list[Sample]:
    """The samples of a set, prepared now or found in the cache.

    Args:
        rendered: targets with photos, and references.
        preparation: how references are aligned.
        cache: folder of prepared sets.
        identity: what tells the content of the set, for instance its folder, step and time of completion.
        workers: threads.
        progress: called after each view.
        held_out: whether the targets are held-out views; False for the set that `training_targets` gives.

    Raises:
        InputError: a view has no photo, or the cache cannot be written.
    """
    content = {"layout": LAYOUT, "identity": identity, "preparation": preparation_of(preparation)}
    content["held_out"] = held_out
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    folder = cache / f"{rendered.name}-{digest}"
    index = folder / "index.json"
    if index.is_file():
        return [Sample(**entry) for entry in json.loads(index.read_text())]
    pool = Pool(rendered.references)

    def prepared(number: int) -> Sample:
        sample = _prepare(rendered, number, preparation, pool, folder)
        progress()
        return dataclasses.replace(sample, held_out=held_out)

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with ThreadPoolExecutor(workers) as executor:
            samples = list(executor.map(prepared, range(len(rendered.targets))))
        with whole_file(index) as temporary:
            temporary.write_text(json.dumps([dataclasses.asdict(sample) for sample in samples]))
    except OSError as error:
        raise unwritable(folder, error) from error
    return samples


def training_targets(rendered: RenderedSet) -> RenderedSet:
    """The training views of a set as targets to simulate: photos in place of their renders, the fit's depth.

    The other training views are their references.

    Args:
        rendered: a fitted run's views.
    """
    targets = tuple(dataclasses.replace(view, read=view.read_photo) for view in rendered.references)
    return dataclasses.replace(rendered, targets=targets)


def _prepare(rendered: RenderedSet, number: int, preparation: Preparation, pool: Pool, folder: Path) -> Sample:
    view = rendered.targets[number]
    target = read_target(view)
    photo = _photo(view, *target.image.shape[-2:])
    aligned = preparation.align(target, view, pool)
    inverse = torch.zeros_like(target.image[:1])
    if target.depth is not None:
        depth = target.depth[None]
        inverse = normalised_inverse_depth(depth, depth_unit(depth))[0] / NEAREST
    fine = (inverse * 65535).round().int()
    alpha = torch.ones_like(inverse) if target.alpha is None else target.alpha
    renders = torch.zeros_like(aligned.references) if aligned.renders is None else aligned.renders
    references = torch.cat([aligned.references, aligned.visibility, renders], dim=1).flatten(0, 1)
    planes = torch.cat(
        [_bytes(target.image), _bytes(photo), _bytes(alpha), fine // 256, fine % 256, _bytes(references)]
    )
    path = folder / f"{number:04d}.npy"
    save_array(path, planes.to(torch.uint8).numpy())
    height, width = planes.shape[-2:]
    known = target.depth is not None, target.alpha is not None
    name, drawn = f"{rendered.name}/{view.name}", aligned.renders is not None
    return Sample(name, str(path), height, width, len(aligned.names), *known, has_reference_renders=drawn)


def _photo(view: RenderedView, height: int, width: int) -> Float[Tensor, "3 {height} {width}"]:
    if view.read_photo is None:
        raise InputError(view.name, "has no photo to learn from", "train on renders of photographed views")
    return resize(view.read_photo(), height, width)


def _bytes(image: Float[Tensor, "p h w"]) -> Tensor:
    return (image.clamp(0, 1) * 255).round().int()


def batch_of(planes: Sequence[UInt8[np.ndarray, "_ h w"]], samples: Sequence[Sample], references: int) -> Batch:
    """A batch from planes of equal size; missing references have visibility 0.

    The references' renders are given where all samples have them.

    Args:
        planes: crops or whole images.
        samples: what they belong to.
        references: places for references.
    """
    wide = [np.pad(p, ((0, FIXED + EACH * references - len(p)), (0, 0), (0, 0))) for p in planes]
    values = torch.from_numpy(np.ascontiguousarray(np.stack(wide)))
    height, width = values.shape[-2:]
    images = values.float() / 255
    inverse = (values[:, 7:8].float() * 256 + values[:, 8:9].float()) * (NEAREST / 65535)
    known = torch.tensor([sample.has_depth for sample in samples])[:, None, None, None]
    depth = torch.where((inverse > 0) & known, 1 / inverse.clamp_min(1e-6), torch.zeros_like(inverse))
    stack = images[:, FIXED:].view(len(samples), references, EACH, height, width)
    renders = stack[:, :, 4:] if all(sample.has_reference_renders for sample in samples) else None
    unit = torch.ones(len(samples))
    views = Views(images[:, :3], stack[:, :, :3], stack[:, :, 3:4], depth, images[:, 6:7], unit, renders)
    return Batch(views, images[:, 3:6], tuple(sample.name for sample in samples))
