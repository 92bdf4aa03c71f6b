"""What a real capture does and a rendered one does not: exposure and white balance by photo, wind, wrong poses.

Axes: f faces.
"""

import math
from dataclasses import dataclass, replace

import torch

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.procedural.world import World
from gaussian_enhancer.types import Camera

Triple = tuple[float, float, float]

_WAVES = 1.7
"""Radians a metre by which neighbouring leaves lag behind each other."""


@dataclass(frozen=True)
class Departure:
    """How one photo departs from the world as it was baked.

    Args:
        gains: factors on linear red, green and blue before the tone curve.
        gust: how far leaves are blown along x, y and z, metres.
        phase: where in its swing the gust is, radians.
    """

    gains: Triple
    gust: Triple
    phase: float

    def of(self, world: World) -> World:
        """The world as this photo sees it: its exposure, and its faces with holes (leaves, nets) moved by the wind."""
        exposure = world.mesh.corners.new_tensor(self.gains) * world.exposure
        if self.gust == (0.0, 0.0, 0.0):
            return replace(world, exposure=exposure)
        corners = world.mesh.corners
        swing = torch.sin(self.phase + _WAVES * corners.mean(dim=1).sum(dim=1)) * world.mesh.cutout
        blown = corners + (swing[:, None] * corners.new_tensor(self.gust))[:, None]
        return replace(world, exposure=exposure, mesh=replace(world.mesh, corners=blown))


@dataclass(frozen=True)
class Imperfections:
    """Sizes of what differs from photo to photo; all are standard deviations, and 0 leaves a thing exact.

    Args:
        exposure: of the camera's auto-exposure, stops.
        white_balance: of red's and of blue's gain, stops.
        pose: error of the stated camera, pixels of a view 256 pixels wide; the photo is taken from the true one.
        wind: displacement of leaves, metres.

    Raises:
        InputError: one is negative or not finite.
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

    def departure(self, generator: torch.Generator) -> Departure:
        """What a photo departs by."""
        stops, red, blue, x, y, z = torch.randn(6, generator=generator, dtype=torch.float64).tolist()
        phase = 2 * math.pi * float(torch.rand((), generator=generator))
        stop = self.exposure * stops
        gains = (2 ** (stop + self.white_balance * red), 2**stop, 2 ** (stop + self.white_balance * blue))
        return Departure(gains, (self.wind * x, self.wind * y, 0.4 * self.wind * z), phase)

    def stated(self, camera: Camera, distance: float, generator: torch.Generator) -> Camera:
        """The camera that a photo is said to have.

        Args:
            camera: the true one.
            distance: from it to what it looks at, metres: half of the error turns, half of it moves.
            generator: source of randomness, on the CPU.
        """
        drawn = torch.randn(6, generator=generator, dtype=torch.float64)
        if self.pose == 0:
            return camera
        angle = self.pose / math.sqrt(2) * camera.width / 256 / float(camera.K[0, 0])
        x, y, z = (angle * drawn[:3]).tolist()
        turn = torch.linalg.matrix_exp(torch.tensor([[0, -z, y], [z, 0, -x], [-y, x, 0]], dtype=torch.float64))
        error = torch.eye(4, dtype=torch.float64)
        error[:3, :3], error[:3, 3] = turn, angle * distance * drawn[3:]
        return Camera(camera.K, (error @ camera.world_to_camera.double()).float(), camera.height, camera.width)
