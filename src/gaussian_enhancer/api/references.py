"""References of the Python API: photos, optionally with camera, render and depth of their views.

Axes: h height, w width.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from torch import Tensor

from gaussian_enhancer.align.references import ReferencePool
from gaussian_enhancer.api.images import read_images, read_planes
from gaussian_enhancer.errors import InputError
from gaussian_enhancer.infer.planner import Planner
from gaussian_enhancer.infer.reference_cache import ReferenceFeatures
from gaussian_enhancer.scene.posed import evenly_resized
from gaussian_enhancer.scene.rendered import RenderedView
from gaussian_enhancer.types import Camera


@dataclass(frozen=True, eq=False)
class Reference:
    """A photo of the scene, used to enhance renders of other views.

    Images are numpy (h, w, 3) or torch (3, h, w), float in [0, 1] or uint8. They may differ in size as long as their
    aspect ratio is the same.

    Args:
        photo: the photo, without lens distortion, as an ideal pinhole camera would take it.
        camera: the photo's camera; required by weights that reproject photos.
        render: the splat's render of the same view (optional). It shows the network the splat's errors, improves the
            exposure correction, and increases the gain.
        depth: the splat's z depth of the same view in scene units, (h, w), 0 where no surface was hit (optional). It
            allows occlusions between the photo's view and the enhanced view to be detected.
        name: unique name. A reference with the name of the enhanced render is left out, since it is the ground truth.

    Raises:
        InputError: an image has a wrong shape or type, or another aspect ratio than the photo, or depth is negative.
    """

    photo: np.ndarray | Tensor
    camera: Camera | None = None
    render: np.ndarray | Tensor | None = None
    depth: np.ndarray | Tensor | None = None
    name: str = ""

    def __post_init__(self) -> None:
        photo_size = _size(self.photo, "photo", self.name)
        if self.camera is not None:
            sized_camera(self.camera, *photo_size, f"camera of reference {self.name}".rstrip())
        for name, image in (("render", self.render), ("depth", self.depth)):
            if image is not None:
                size = _size(image, name, self.name)
                if not evenly_resized(photo_size, size):
                    received = f"is {size[1]}x{size[0]} for a photo of {photo_size[1]}x{photo_size[0]}"
                    raise InputError(
                        f"{name} of reference {self.name}".rstrip(), received, "give it in the same aspect"
                    )


@dataclass
class CachedReferences:
    """References, and data that earlier calls computed from them.

    Args:
        references: the references as the user gave them.
        views: the references as views, whose pixels are converted when they are read.
        pool: cache of the pixels of the views that were read last.
        planner: planner that caches views on a coarse grid; None if the plan leaves nothing out.
        features: cached network features of references that are not warped; None if references are warped.
        depth_fits: whether validation accepted the depth of the renders.
    """

    references: tuple[Reference, ...]
    views: tuple[RenderedView, ...]
    pool: ReferencePool = field(init=False)
    planner: Planner | None = None
    features: ReferenceFeatures | None = None
    depth_fits: bool = False

    def __post_init__(self) -> None:
        self.pool = ReferencePool(self.views)

    @classmethod
    def of(cls, references: Sequence[Reference], fine: bool) -> "CachedReferences":
        """Create views of references, without any cached data.

        Args:
            references: references with unique names; those without a name get one.
            fine: also read the photos at their original resolution, for super-resolution.

        Raises:
            InputError: a name occurs twice, or an item is not a `Reference`.
        """
        views: dict[str, RenderedView] = {}
        for number, reference in enumerate(references):
            if not isinstance(reference, Reference):
                received = f"hold a {type(reference).__name__}"
                raise InputError(
                    "references", received, "give gaussian_enhancer.Reference(photo, camera, render, depth)"
                )
            name = reference.name or f"reference {number}"
            if name in views:
                raise InputError(f"reference {name}", "stands twice", "give each reference a unique name")
            views[name] = _view(reference, name, fine)
        return cls(tuple(references), tuple(views.values()))

    def are_same(self, references: Sequence[Reference]) -> bool:
        """Whether these are the same objects as the references in use."""
        return len(references) == len(self.references) and all(map(lambda a, b: a is b, references, self.references))


def sized_camera(camera: Camera, height: int, width: int, name: str) -> Camera:
    """The camera scaled to an image's size, on the CPU. The image may be a uniformly resized version.

    Raises:
        InputError: the value is not a camera, or the aspect ratios differ by more than rounding explains.
    """
    if not isinstance(camera, Camera):
        remedy = "give gaussian_enhancer.Camera.from_matrices(K, world_to_camera, height, width)"
        raise InputError(name, f"is of type {type(camera).__name__}", remedy)
    if not evenly_resized((height, width), (camera.height, camera.width)):
        received = f"is for {camera.width}x{camera.height}, and the image is {width}x{height}"
        raise InputError(name, received, "give the camera that the image was made with")
    return camera.to("cpu").resized(height, width)


def _view(reference: Reference, name: str, fine: bool) -> RenderedView:
    def photo() -> Tensor:
        return read_images(f"photo of {name}", reference.photo)[0][0]

    def render() -> Tensor:
        return read_images(f"render of {name}", reference.render)[0][0]

    def depth() -> Tensor:
        return read_planes(f"depth of {name}", reference.depth, batch=False)[0]

    shape = reference.photo.shape  # validated when the reference was created
    height, width = shape[-2:] if isinstance(reference.photo, Tensor) else shape[:2]
    camera = None if reference.camera is None else sized_camera(reference.camera, height, width, f"camera of {name}")
    return RenderedView(
        name,
        None if reference.render is None else render,
        camera,
        None if reference.depth is None else depth,
        None,
        photo,
        photo if fine else None,
    )


def _size(image: Any, kind: str, name: str) -> tuple[int, int]:
    """Validate the photo, render or depth of a reference and return its height and width."""
    subject = f"{kind} of reference {name}".rstrip()
    if kind == "depth":
        height, width = read_planes(subject, image, batch=False).shape[-2:]
        return height, width
    images, image_kind = read_images(subject, image)
    if image_kind.batch:
        raise InputError(subject, f"has shape {tuple(image.shape)}", "give one image, without a batch axis")
    return images.shape[-2], images.shape[-1]
