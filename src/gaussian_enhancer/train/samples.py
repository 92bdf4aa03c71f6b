"""Prepared training samples on disk, whose references are warped once, at full size.

A sample is one `.npy` file of 8-bit planes (p h w): render 3, photo 3, alpha 1, inverse depth 2 (16 bits, high byte
first; 65535 stands for `MAX_INVERSE_DEPTH`), then for each reference colour 3, visibility 1 and the splat's own render
of its view 3, warped alike. The file is memory-mapped, so that a crop reads only its own rows. Warping commutes with
cropping and flipping, so that augmentation can work on the warped planes.
A training view is prepared for simulation only. It has its photo in place of its render, which was fitted to the photo.
For super-resolution a second `.npy` holds planes 4 times as fine: photo 3, then 3 for each reference.
Axes: p planes, h height, w width, r references, H = 4 h, W = 4 w.
"""

import dataclasses
import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, UInt8
from torch import Tensor

from gaussian_enhancer.align.alignment import AlignedReferences, LoadedView
from gaussian_enhancer.align.depth_normalisation import MAX_INVERSE_DEPTH, depth_unit, normalised_inverse_depth
from gaussian_enhancer.align.exposure import apply_colour, fit_exposure
from gaussian_enhancer.align.references import ReferenceConfig, ReferencePool, read_target
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.files import atomic_write, load_array, save_array, to_write_error
from gaussian_enhancer.infer.weights import reference_config_of
from gaussian_enhancer.scene.photos import resize
from gaussian_enhancer.scene.rendered import RenderedSet
from gaussian_enhancer.types import Batch, NetworkInput

LAYOUT_VERSION = 5
"""Version of the layout of planes; part of the cache key."""
FIXED_PLANES = 9
"""Planes before those of the references."""
PLANES_PER_REFERENCE = 7
"""Planes per reference."""
PLANES_PER_FINE_IMAGE = 3
"""Fine planes of the photo, and of each reference."""


@dataclass(frozen=True)
class Sample:
    """One prepared training sample.

    Args:
        name: set and view.
        path: file of the planes.
        height: in pixels.
        width: in pixels.
        references: number of references.
        has_depth: whether depth is known.
        has_alpha: whether opacity is known.
        held_out: whether the render was not fitted to the photo, so that the pair can be trained on.
        has_reference_renders: whether the splat's own renders of the references' views are known.
        fine: file of the planes that are 4 times as fine; empty if there are none.
        bad: names of the images that are not finite; such a sample has no planes and cannot be used. Empty otherwise.
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
    fine: str = ""
    bad: str = ""

    def planes(self) -> np.ndarray:
        """The planes, memory-mapped."""
        return load_array(self.path)

    def fine_planes(self) -> np.ndarray | None:
        """The planes that are 4 times as fine, memory-mapped; None if there are none."""
        return load_array(self.fine) if self.fine else None


def prepare_samples(
    rendered: RenderedSet,
    reference_config: ReferenceConfig,
    cache: Path,
    identity: str,
    workers: int = 2,
    progress: Callable[[], None] = lambda: None,
    held_out: bool = True,
    match_exposure: bool = False,
) -> list[Sample]:
    """Prepare the samples of a set, or read them from the cache.

    A file lock makes sure that only one of several simultaneous trainings prepares them.

    Args:
        rendered: targets with photos, and references.
        reference_config: how references are aligned.
        cache: folder of prepared sets.
        identity: text that identifies the content of the set, for instance its folder, step and time of completion.
        workers: number of threads.
        progress: called after each view.
        held_out: whether the targets are held-out views; False for the result of `training_targets`.
        match_exposure: match each photo to the exposure of its render (`fit_exposure`).

    Raises:
        InputError: a view has no photo, or the cache cannot be written.
    """
    content = {
        "layout": LAYOUT_VERSION,
        "identity": identity,
        "reference_config": reference_config_of(reference_config),
        "held_out": held_out,
    }
    if match_exposure:
        content["match_exposure"] = True
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:12]
    folder = cache / f"{rendered.name}-{digest}"
    index = folder / "index.json"
    if index.is_file():
        return _read_index(index)
    pool = ReferencePool(rendered.references)

    def prepared(number: int) -> Sample:
        sample = _prepare(rendered, number, reference_config, pool, folder, match_exposure)
        progress()
        return dataclasses.replace(sample, held_out=held_out)

    from filelock import FileLock

    try:
        folder.mkdir(parents=True, exist_ok=True)
        with FileLock(folder / "lock"):
            if index.is_file():  # another training has prepared the set meanwhile
                return _read_index(index)
            with ThreadPoolExecutor(workers) as executor:
                samples = list(executor.map(prepared, range(len(rendered.targets))))
            with atomic_write(index) as temporary:
                temporary.write_text(json.dumps([_entry(sample) for sample in samples]))
    except OSError as error:
        raise to_write_error(folder, error) from error
    return samples


def _read_index(index: Path) -> list[Sample]:
    """Read the samples of a prepared set from its index, whose files are beside it wherever the cache has moved to."""

    def beside(path: str) -> str:
        return path and str(index.parent / Path(path).name)

    samples = [Sample(**entry) for entry in json.loads(index.read_text())]
    return [dataclasses.replace(sample, path=beside(sample.path), fine=beside(sample.fine)) for sample in samples]


def training_targets(rendered: RenderedSet) -> RenderedSet:
    """The set with its training views as targets for simulation: photos in place of the renders, the fit's depth.

    The references of a training view are the other training views.

    Args:
        rendered: a fitted run's views.
    """
    targets = tuple(dataclasses.replace(view, read=view.read_photo) for view in rendered.references)
    return dataclasses.replace(rendered, targets=targets)


def _entry(sample: Sample) -> dict[str, Any]:
    """A sample's values as stored in the index; empty ``fine`` and ``bad`` are left out, as in older indices."""
    return {name: value for name, value in dataclasses.asdict(sample).items() if name not in ("fine", "bad") or value}


def _prepare(
    rendered: RenderedSet,
    number: int,
    reference_config: ReferenceConfig,
    pool: ReferencePool,
    folder: Path,
    match_exposure: bool,
) -> Sample:
    """Prepare the sample of one target: read it, align its references, and write its planes."""
    view = rendered.targets[number]
    name, target = f"{rendered.name}/{view.name}", read_target(view)
    height, width = target.image.shape[-2:]
    photo = _photo(view.name, view.read_photo, height, width)
    if bad := _non_finite_names({"render": target.image, "photo": photo, "opacity": target.alpha}):
        # Rounding to bytes would turn NaN into an ordinary colour.
        return Sample(name, "", height, width, 0, False, False, bad=bad)
    exposure = fit_exposure(photo, target.image) if match_exposure else None
    if exposure is not None:
        photo = apply_colour(photo, exposure)
    aligned = reference_config.align(target, view, pool)
    path = folder / f"{number:04d}.npy"
    save_array(path, _planes(target, photo, aligned).to(torch.uint8).numpy())
    fine_path = ""
    if reference_config.fine:
        fine_path = str(folder / f"{number:04d}-fine.npy")
        fine_photo = _photo(view.name, view.read_fine_photo, 4 * height, 4 * width)
        fine_photo = fine_photo if exposure is None else apply_colour(fine_photo, exposure)
        save_array(fine_path, _fine_planes(fine_photo, aligned).to(torch.uint8).numpy())
    return Sample(
        name,
        str(path),
        height,
        width,
        references=len(aligned.names),
        has_depth=target.depth is not None,
        has_alpha=target.alpha is not None,
        has_reference_renders=aligned.renders is not None,
        fine=fine_path,
    )


def _non_finite_names(images: Mapping[str, Tensor | None]) -> str:
    """Names of the images with values that are not finite; empty if there are none."""
    return ", ".join(n for n, image in images.items() if image is not None and not bool(torch.isfinite(image).all()))


def _planes(target: LoadedView, photo: Float[Tensor, "3 h w"], aligned: AlignedReferences) -> Tensor:
    """Planes in the layout of the file, with missing opacity 1, and missing depth and renders 0."""
    inverse = torch.zeros_like(target.image[:1])
    if target.depth is not None:
        depth = target.depth[None]
        inverse = normalised_inverse_depth(depth, depth_unit(depth))[0] / MAX_INVERSE_DEPTH
    depth_levels = (inverse * 65535).round().int()
    alpha = torch.ones_like(inverse) if target.alpha is None else target.alpha
    renders = torch.zeros_like(aligned.references) if aligned.renders is None else aligned.renders
    references = torch.cat([aligned.references, aligned.visibility, renders], dim=1).flatten(0, 1)
    colours = _bytes(torch.cat([target.image, photo, alpha]))
    return torch.cat([colours, depth_levels // 256, depth_levels % 256, _bytes(references)])


def _fine_planes(photo: Float[Tensor, "3 H W"], aligned: AlignedReferences) -> Tensor:
    if aligned.fine is None:
        return _bytes(photo)
    return torch.cat([_bytes(photo), _bytes(aligned.fine.float().flatten(0, 1))])


def _photo(
    name: str, read: Callable[[], Float[Tensor, "3 _ _"]] | None, height: int, width: int
) -> Float[Tensor, "3 {height} {width}"]:
    if read is None:
        raise InputError(name, f"has no photo of {width}x{height} to learn from", "train on renders of such photos")
    return resize(read(), height, width)


def _bytes(image: Float[Tensor, "p h w"]) -> Tensor:
    return (image.clamp(0, 1) * 255).round().int()


def make_batch(
    planes: Sequence[UInt8[np.ndarray, "_ h w"]],
    samples: Sequence[Sample],
    references: int,
    fine: Sequence[UInt8[np.ndarray, "_ H W"] | None] = (),
) -> Batch:
    """Make a batch from planes of equal size; missing references have visibility 0.

    The references' renders are included if all samples have them. The same applies to the fine photo and references.

    Args:
        planes: planes of crops or of whole images.
        samples: the sample of each.
        references: number of references per sample in the batch.
        fine: the same planes 4 times as fine.
    """
    stacked = _stack(planes, FIXED_PLANES + PLANES_PER_REFERENCE * references)
    height, width = stacked.shape[-2:]
    images = stacked.float() / 255
    inverse = (stacked[:, 7:8].float() * 256 + stacked[:, 8:9].float()) * (MAX_INVERSE_DEPTH / 65535)
    has_depth = torch.tensor([sample.has_depth for sample in samples])[:, None, None, None]
    depth = torch.where((inverse > 0) & has_depth, 1 / inverse.clamp_min(1e-6), torch.zeros_like(inverse))
    reference_planes = images[:, FIXED_PLANES:].view(len(samples), references, PLANES_PER_REFERENCE, height, width)
    views = NetworkInput(
        render=images[:, :3],
        references=reference_planes[:, :, :3],
        visibility=reference_planes[:, :, 3:4],
        depth=depth,
        alpha=images[:, 6:7],
        depth_unit=torch.ones(len(samples)),
        reference_renders=reference_planes[:, :, 4:] if all(s.has_reference_renders for s in samples) else None,
    )
    photo, fine_planes = images[:, 3:6], [planes for planes in fine if planes is not None]
    if fine_planes and len(fine_planes) == len(samples):
        fine_images = _stack(fine_planes, PLANES_PER_FINE_IMAGE * (1 + references)).float() / 255
        photo, fine_references = fine_images[:, :PLANES_PER_FINE_IMAGE], fine_images[:, PLANES_PER_FINE_IMAGE:]
        fine_references = fine_references.unflatten(1, (references, PLANES_PER_FINE_IMAGE))
        views = dataclasses.replace(views, fine_references=fine_references)
    return Batch(views, photo, tuple(sample.name for sample in samples))


def _stack(planes: Sequence[UInt8[np.ndarray, "_ h w"]], count: int) -> UInt8[Tensor, "b p h w"]:
    padded = [np.pad(p, ((0, count - len(p)), (0, 0), (0, 0))) for p in planes]
    return torch.from_numpy(np.ascontiguousarray(np.stack(padded)))
