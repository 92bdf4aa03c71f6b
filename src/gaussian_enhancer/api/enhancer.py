"""`Enhancer`: enhance renders from Python, in a notebook or a trainer's render loop.

Axes: b batch, h height, w width; H, W: height and width times the weights' scale.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from gaussian_enhancer.align.alignment import Reprojected, Unwarped
from gaussian_enhancer.api.images import (
    Array,
    check_same_size,
    one_per_image,
    read_background,
    read_images,
    read_planes,
)
from gaussian_enhancer.api.references import CachedReferences, Reference, sized_camera
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.options import EnhancementOptions
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.infer.validated_inputs import ValidatedInputs, validate_inputs
from gaussian_enhancer.infer.weights import Pretrained, load_weights
from gaussian_enhancer.network.network import CachesReferences
from gaussian_enhancer.runs.runtime import choose_device
from gaussian_enhancer.scene.rendered import RenderedSet, RenderedView
from gaussian_enhancer.types import Camera


class Enhancer:
    """Enhances renders of a splat with the help of photos of the same scene.

    The result is the same as that of ``gaussian-enhancer enhance`` for the same input. Images are numpy (h, w, 3) or
    torch (3, h, w), float in [0, 1] or uint8, one or a batch. Cameras follow OpenCV's convention
    (`Camera.from_matrices`). All inputs are moved to the CPU, where references are chosen; warps and the network run on
    ``device``. Gradients are not propagated.

    Args:
        pretrained: weights from `load_weights`.
        device: device of the network: "cpu", "cuda", "cuda:1", ...; None selects CUDA if it is available.
        background: background colour, three numbers in [0, 1] or an array of them. Regions of a render that show only
            this colour are passed through.
        options: options of the enhancement.

    Raises:
        InputError: an option is out of range, or the device does not exist.

    Example:
        >>> import torch
        >>> from gaussian_enhancer import Camera, Enhancer, Reference
        >>> enhancer = Enhancer.from_pretrained("lr_tiny", device="cpu")
        >>> camera = Camera.from_matrices([[50, 0, 16], [0, 50, 12], [0, 0, 1]], torch.eye(4), height=24, width=32)
        >>> photo, depth = torch.rand(3, 24, 32), torch.full((24, 32), 2.0)
        >>> references = [Reference(photo, camera, render=photo, depth=depth)]
        >>> image = enhancer(photo, camera=camera, depth=depth, references=references)
        >>> image.shape, image.dtype
        (torch.Size([3, 24, 32]), torch.float32)
    """

    def __init__(
        self,
        pretrained: Pretrained,
        device: str | torch.device | None = None,
        background: Sequence[int | float] | Array = (0.0, 0.0, 0.0),
        options: EnhancementOptions | None = None,
    ) -> None:
        self.pretrained, self.device = pretrained, _device(device)
        self.background = read_background(background)
        self.options = EnhancementOptions() if options is None else options
        self.reference_config = self.options.reference_config(pretrained, "expected")
        self._set_enhancer = self.options.enhancer(pretrained, self.reference_config, self.device)
        self._added_references = self._call_references = CachedReferences.of((), False)

    @classmethod
    def from_pretrained(
        cls,
        weights: str | Path = "lr_tiny",
        device: str | torch.device | None = None,
        background: Sequence[int | float] | Array = (0.0, 0.0, 0.0),
        **options: Any,
    ) -> "Enhancer":
        """Create an enhancer with weights of the package or from a file.

        Args:
            weights: a name ("lr_tiny", "sr_tiny") or the path of a ``.safetensors`` file.
            device: device of the network; None selects CUDA if it is available.
            background: background colour, three numbers in [0, 1] or an array of them.
            **options: fields of `EnhancementOptions`, for instance ``strength=0.5`` or ``depth_kind="surface"``.

        Raises:
            InputError: the weights do not exist, the file is damaged, or an option is out of range.
        """
        return cls(load_weights(weights), device, background, EnhancementOptions.of(**options))

    @property
    def scale(self) -> int:
        """Width of the enhanced image divided by the render's: 1, or 4 for super-resolution weights."""
        return self.pretrained.network.scale

    @property
    def references(self) -> tuple[Reference, ...]:
        """The references added so far, which are kept between calls."""
        return self._added_references.references

    def add_reference(self, reference: Reference) -> None:
        """Add a reference for all later calls without an argument ``references``.

        Its converted pixels, and data computed from them, are cached.

        Args:
            reference: a photo, and optionally the camera, render and depth of its view.

        Raises:
            InputError: the argument is not a `Reference`, or its name is taken.
        """
        self._added_references = CachedReferences.of(
            (*self._added_references.references, reference), self.reference_config.fine
        )

    def clear_references(self) -> None:
        """Remove all added references, and all cached data of references."""
        self._added_references = self._call_references = CachedReferences.of((), False)

    def __call__(
        self,
        render: np.ndarray | Tensor,
        camera: Camera | Sequence[Camera] | None = None,
        depth: np.ndarray | Tensor | None = None,
        references: Sequence[Reference] | None = None,
        *,
        alpha: np.ndarray | Tensor | None = None,
        name: str | Sequence[str] | None = None,
    ) -> np.ndarray | Tensor:
        """Enhance one render or a batch.

        Args:
            render: numpy (h, w, 3) or torch (3, h, w), float in [0, 1] or uint8; a batch has an additional first axis.
            camera: camera of the render; a list for a batch. Required if references are reprojected.
            depth: rendered z depth in scene units, 0 where no surface was hit: (h, w), for a batch (b, h, w). Required
                if references are reprojected.
            references: references for this call; None uses the references that were added, an empty list uses none.
                If the next call passes the same objects, data computed from them is reused.
            alpha: rendered opacity in [0, 1], (h, w) or (b, h, w); optional, shows where the render has holes.
            name: name of the render; a list for a batch. A reference of that name is left out, for instance the photo
                of the same view.

        Returns:
            The enhanced image, with the render's library, type, device and size (4 times the size at super-resolution).
            Without references it is computed from the render alone.

        Raises:
            InputError: a shape or type is wrong, sizes differ, values are not finite, or references were given without
                the camera or depth that reprojecting them requires.

        Warns:
            UserWarning: references, or their photos at super-resolution, are not used. The text states the reason, for
                instance that the depth does not fit the renders.
        """
        images, kind = read_images("render", render)
        cached = self._references_of_call(references)
        targets = self._target_views(images, kind.batch, camera, depth, alpha, name)
        self._check_geometry(targets, cached)
        rendered = RenderedSet("input", targets, cached.views, self.background, cached.depth_fits)
        config, rules = self.reference_config, self.options.rules
        if not cached.views:
            config = EnhancementOptions(max_references=0).reference_config(self.pretrained, "expected")
        validated = validate_inputs(rendered, config, rules, self.scale, cached.pool)
        if validated.missing_references:
            warnings.warn("; ".join(validated.missing_references), stacklevel=2)
        self._cache_references(cached, validated)
        self._set_enhancer.reference_config = validated.reference_config
        planner = cached.planner if cached.planner is not None else validated.planner(rules)
        enhanced = self._set_enhancer(validated.rendered, planner, validated.pool, cached.features)
        result = torch.stack([item.image for item in enhanced])
        if planner is not None:
            planner.plans.clear()
        return kind.restore_kind(result)

    def _references_of_call(self, references: Sequence[Reference] | None) -> CachedReferences:
        """The references of a call: those added, or the given ones, cached as long as calls pass the same objects."""
        if references is None:
            return self._added_references
        if isinstance(references, Reference):
            raise InputError("references", "is one reference", "give a list: references=[reference]")
        if not self._call_references.are_same(references):
            self._call_references = CachedReferences.of(tuple(references), self.reference_config.fine)
        return self._call_references

    def _target_views(
        self, images: Tensor, batch: bool, camera: Any, depth: Any, alpha: Any, name: Any
    ) -> tuple[RenderedView, ...]:
        """Validate the renders of a call and return them as views."""
        count, height, width = len(images), *images.shape[-2:]
        depth_and_alpha = {
            plane_name: None if array is None else read_planes(plane_name, array, batch)
            for plane_name, array in (("depth", depth), ("alpha", alpha))
        }
        for plane_name, plane in depth_and_alpha.items():
            if plane is not None:
                check_same_size(plane_name, plane, "render", images)
        cameras = one_per_image("camera", camera, count, batch)
        names = [label or f"render {i}" for i, label in enumerate(one_per_image("name", name, count, batch))]
        if len(set(names)) < count:
            raise InputError("name", f"is {names}", "give each render of a batch a unique name")
        return tuple(
            RenderedView(
                names[i],
                _reader(images, i),
                None if cameras[i] is None else sized_camera(cameras[i], height, width, "camera"),
                _reader(depth_and_alpha["depth"], i),
                _reader(depth_and_alpha["alpha"], i),
            )
            for i in range(count)
        )

    def _check_geometry(self, targets: Sequence[RenderedView], cached: CachedReferences) -> None:
        """Refuse references that cannot be reprojected because a camera or depth is missing.

        Raises:
            InputError: a camera or depth is missing.
        """
        config = self.reference_config
        if not cached.views or not config.references or not isinstance(config.warp, Reprojected):
            return
        for view in targets:
            for name, value in (("camera", view.camera), ("depth", view.read_depth)):
                if value is None:
                    remedy = f"give {name}=, or references=[] to enhance from the render alone"
                    raise InputError(view.name, f"has references but no {name} to reproject them by", remedy)
        without_camera = next((view.name for view in cached.views if view.camera is None), None)
        if without_camera is not None:
            raise InputError(f"reference {without_camera}", "has no camera", "give Reference(photo, camera, ...)")

    def _cache_references(self, cached: CachedReferences, validated: ValidatedInputs) -> None:
        """Cache what later calls with the same references can reuse."""
        if validated.pool is not cached.pool:
            cached.planner = None  # depth was refused in this call, including that of the references
            return
        cached.depth_fits = bool(cached.views) and self.options.rules.depth == "auto"
        if cached.planner is None and not self.options.rules.full:
            cached.planner = Planner(
                self.options.rules, validated.reference_config, validated.rendered, pool=cached.pool
            )
        network = self.pretrained.network
        unwarped = isinstance(validated.reference_config.warp, Unwarped)
        if cached.features is None and isinstance(network, CachesReferences) and unwarped:
            cached.features = ReferenceFeatures(network)


def _reader(batch: Tensor | None, index: int) -> Any:
    """A function that returns one item of a batch; None if there is no batch."""
    return None if batch is None else lambda: batch[index]


def _device(device: str | torch.device | None) -> torch.device:
    """Convert an argument ``device`` to a device.

    Raises:
        InputError: the device does not exist.
    """
    if device is None:
        return choose_device("auto")
    try:
        chosen = torch.device(device)
    except (RuntimeError, TypeError) as error:
        raise InputError("device", f"is {device!r}", 'give "cpu" or "cuda"') from error
    if chosen.type == "cuda" and not torch.cuda.is_available():
        raise InputError("device", f"is {device!r}, but torch finds no CUDA device", 'give "cpu"')
    try:
        torch.zeros(1, device=chosen).cpu()
    except (RuntimeError, AssertionError, NotImplementedError) as error:
        raise InputError("device", f"is {device!r}, which torch cannot use here", 'give "cpu" or "cuda"') from error
    return chosen
