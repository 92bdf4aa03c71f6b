"""Near plane of a scene, for scenes in any unit of length."""

from collections.abc import Sequence

from gaussian_enhancer.splat.fit.geometry import camera_extent
from gaussian_enhancer.types import Camera

NEAR = 0.01
"""Near plane in scene units, as in 3DGS: the smallest z that is drawn."""
ORDINARY_EXTENTS = (0.01, 1e4)
"""Camera extents for which `NEAR` is used: in metres, from about a centimetre to 10 km."""
EXTENT_SHARE = 0.0025
"""Near plane of other scenes as a share of the camera extent: 0.01 at an extent of 4."""


def near_plane(cameras: Sequence[Camera]) -> float:
    """Near plane of a scene: the smallest z that is drawn.

    3DGS's 0.01 would cut off everything in a scene in units of 10 km, and nothing in a scene in micrometres. The near
    plane is therefore proportional to the camera extent where the extent is outside `ORDINARY_EXTENTS`.

    Args:
        cameras: cameras of the scene; without any, `NEAR` is returned.
    """
    extent = camera_extent(cameras) if cameras else 1.0
    return NEAR if ORDINARY_EXTENTS[0] <= extent <= ORDINARY_EXTENTS[1] else EXTENT_SHARE * extent
