"""Imperfections of real captures: exposure and white balance that vary from photo to photo, wind, and pose errors.

Axes: f faces.
"""

import math
from dataclasses import dataclass, replace

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.procedural.world import World
from gaussian_enhancer.types import Camera

Triple = tuple[float, float, float]

_WIND_FREQUENCY = 1.7
"""Spatial frequency of the wind's wave over the leaves, in radians per metre along each axis."""


@dataclass(frozen=True)
class PhotoDeviation:
    """Deviation of one photo from the baked world.

    Args:
        gains: factors on linear red, green and blue before the tone curve.
        gust: amplitude of the displacement of leaves along x, y and z, metres.
        phase: phase of the leaves' oscillation, radians.
    """

    gains: Triple
    gust: Triple
    phase: float

    def apply_to(self, world: World) -> World:
        """Apply the deviation to a world: change the exposure, and displace faces with holes (leaves, nets) by wind."""
        exposure = world.mesh.corners.new_tensor(self.gains) * world.exposure
        if self.gust == (0.0, 0.0, 0.0):
            return replace(world, exposure=exposure)
        corners = world.mesh.corners
        oscillation = torch.sin(self.phase + _WIND_FREQUENCY * corners.mean(dim=1).sum(dim=1)) * world.mesh.cutout
        displaced_corners = corners + (oscillation[:, None] * corners.new_tensor(self.gust))[:, None]
        return replace(world, exposure=exposure, mesh=replace(world.mesh, corners=displaced_corners))


@dataclass(frozen=True)
class Imperfections:
    """Sizes of the imperfections. All are standard deviations over the photos; 0 disables an imperfection.

    Args:
        exposure: variation of exposure, stops.
        white_balance: variation of the gains of red and blue, stops.
        pose: error of the stated camera, pixels of a view 256 pixels wide; photos are rendered with the true camera.
        wind: horizontal displacement of leaves, metres; the vertical one is 0.4 of it.

    Raises:
        InputError: a value is negative or not finite.
    """

    exposure: float = 0.0
    white_balance: float = 0.0
    pose: float = 0.0
    wind: float = 0.0

    def __post_init__(self) -> None:
        for name in ("exposure", "white_balance", "pose", "wind"):
            value = getattr(self, name)
            if not math.isfinite(value) or value < 0:
                raise InputError(f"scene.imperfections.{name}", f"is {value}", "give 0 or more")

    def draw_deviation(self, generator: torch.Generator) -> PhotoDeviation:
        """Draw the deviation of a photo."""
        exposure_noise, red_noise, blue_noise, x, y, z = torch.randn(
            6, generator=generator, dtype=torch.float64
        ).tolist()
        phase = 2 * math.pi * float(torch.rand((), generator=generator))
        stop = self.exposure * exposure_noise
        gains = (2 ** (stop + self.white_balance * red_noise), 2**stop, 2 ** (stop + self.white_balance * blue_noise))
        return PhotoDeviation(gains, (self.wind * x, self.wind * y, 0.4 * self.wind * z), phase)

    def with_pose_error(self, camera: Camera, distance: float, generator: torch.Generator) -> Camera:
        """Return the true camera with a random pose error.

        Args:
            camera: the true camera.
            distance: distance from the camera to the point that it looks at, metres. Rotation and translation have
                equal shares in the variance of the error.
            generator: random number generator, on the CPU.
        """
        normal_noise = torch.randn(6, generator=generator, dtype=torch.float64)
        if self.pose == 0:
            return camera
        angle = self.pose / math.sqrt(2) * camera.width / 256 / float(camera.K[0, 0])
        x, y, z = (angle * normal_noise[:3]).tolist()
        rotation = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64))
        error_pose = torch.eye(4, dtype=torch.float64)
        error_pose[:3, :3], error_pose[:3, 3] = rotation, angle * distance * normal_noise[3:]
        return Camera(camera.K, (error_pose @ camera.world_to_camera.double()).float(), camera.height, camera.width)
