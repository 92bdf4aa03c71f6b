"""Training photos of a fit: validated at its start, and cached in prepared form up to a limit of memory.

Axes: h height, w width.
"""

import torch
from jaxtyping import Float
from torch import Tensor

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.scene import Photo, Scene
from gaussian_enhancer.splat.fit.similarity import PreparedPhoto, prepare
from gaussian_enhancer.types import Camera

MEMORY_LIMIT = 4 * 2**30
"""Bytes that prepared photos may take; the other photos are read again at each use."""


class TrainingPhotos:
    """Training photos by index.

    Args:
        scene: the scene; its training photos need cameras.
        device: where the fit computes.

    Raises:
        InputError: fewer than two training photos, or a training or test photo without a camera, of another size than
            its camera, or with values that are not finite.
    """

    def __init__(self, scene: Scene, device: torch.device) -> None:
        if len(scene.train) < 2:
            received = f"has {len(scene.train)} training photo{'s' * (len(scene.train) != 1)}"
            raise InputError(f"scene {scene.name}", received, "give at least two photos to fit to")
        self._photos = scene.train_photos
        self._device = device
        self.cameras: list[Camera] = [photo.require_camera() for photo in self._photos]
        for photo in scene.test_photos:  # invalid test photos are reported now, not after the fit
            _read_checked(photo)
        self._prepared: dict[int, PreparedPhoto] = {}
        free_memory = MEMORY_LIMIT
        for number, photo in enumerate(self._photos):
            pixels = _read_checked(photo)
            if free_memory >= 0:
                self._prepared[number] = prepare(pixels.to(device))
                free_memory -= 3 * pixels.nbytes

    def __len__(self) -> int:
        return len(self._photos)

    def pixels(self, number: int) -> Float[Tensor, "3 _ _"]:
        """A photo in [0, 1], on the CPU.

        Args:
            number: index among the training photos.
        """
        prepared = self._prepared.get(number)
        return self._photos[number].read() if prepared is None else prepared.photo.cpu()

    def target(self, number: int) -> PreparedPhoto:
        """A photo prepared for the loss.

        Args:
            number: index among the training photos.
        """
        prepared = self._prepared.get(number)
        return prepared if prepared is not None else prepare(self.pixels(number).to(self._device))


def _read_checked(photo: Photo) -> Float[Tensor, "3 h w"]:
    camera = photo.require_camera()
    pixels = photo.read()
    if pixels.shape[1:] != (camera.height, camera.width):
        received = f"is {pixels.shape[2]}x{pixels.shape[1]} but its camera is {camera.width}x{camera.height}"
        raise InputError(f"photo {photo.name}", received, "give photos of the cameras' size")
    if not pixels.isfinite().all():
        raise InputError(f"photo {photo.name}", "holds values that are not finite", "replace the photo")
    return pixels
