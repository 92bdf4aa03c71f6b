"""Enhanced views at new cameras with confidence maps, on disk, so that a resumed run does not make them again.

Axes: h height, w width.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.align.references import ReferencePool, build_network_input, read_target
from gaussian_enhancer.infer.enhancer import SetEnhancer
from gaussian_enhancer.runs.rendered_capture import SplatRenderer
from gaussian_enhancer.scene.image_files import write_image
from gaussian_enhancer.scene.photos import read_photo
from gaussian_enhancer.scene.scene import Photo
from gaussian_enhancer.types import Camera


@dataclass(frozen=True)
class EnhancedViews:
    """The enhanced views of one round.

    Args:
        folder: folder of the views, which need not exist.
        cameras: cameras of the views, in order.
    """

    folder: Path
    cameras: Sequence[Camera]

    def __len__(self) -> int:
        return len(self.cameras)

    def read(self, index: int) -> tuple[Float[Tensor, "3 h w"], Float[Tensor, "1 h w"]]:
        """Read a view and its confidence map, which are stored in 8 bits.

        Raises:
            InputError: a file is missing or damaged.
        """
        return read_photo(self._image(index)), read_photo(self._confidence(index))[:1]

    def make(self, renderer: SplatRenderer, photos: Sequence[Photo], enhancer: SetEnhancer) -> Iterator[int]:
        """Render and enhance the views that are not on disk yet; yield the index of each.

        The confidence of a pixel is the largest visibility of its surface in the references, in [0, 1]. It is 0 where
        no photo shows the surface.

        Args:
            renderer: renders the splat.
            photos: training photos, which are the references.
            enhancer: enhancer at the render's own resolution.

        Raises:
            InputError: a photo cannot be read, or the folder cannot be written.
        """
        pool = ReferencePool(tuple(map(renderer.reference, photos)))
        for index, camera in enumerate(self.cameras):
            if self._confidence(index).is_file():
                continue
            view = renderer.target(self._image(index).name, camera)
            target = read_target(view).to_device(enhancer.device)
            aligned = enhancer.reference_config.align(target, view, pool)
            enhanced_image = enhancer.enhance(build_network_input(target, aligned), aligned.names)[0]
            visibility = aligned.visibility if len(aligned.names) else torch.zeros_like(target.image[None, :1])
            write_image(self._image(index), enhanced_image)
            write_image(self._confidence(index), visibility.amax(0))
            yield index

    def _image(self, index: int) -> Path:
        return self.folder / f"view_{index:04d}.png"

    def _confidence(self, index: int) -> Path:
        return self.folder / "confidence" / f"view_{index:04d}.png"
