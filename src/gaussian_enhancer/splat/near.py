"""Where drawing begins, for scenes of any unit."""

from collections.abc import Sequence

from gaussian_enhancer.splat.fit.geometry import camera_extent
from gaussian_enhancer.types import Camera

NEAR = 0.01
"""Smallest z that is drawn, in scene units: 3DGS's."""
ORDINARY = (0.01, 1e4)
"""Camera extents for which that serves, from a few centimetres in metres to a region."""
SHARE = 0.0025
"""The same as a share of the camera extent in other scenes: 0.01 of an extent of 4."""


def near_plane(cameras: Sequence[Camera]) -> float:
    """Smallest z that is drawn of a scene.

    3DGS's 0.01 cuts everything off in a scene in units of 10 km, and nothing in one of micrometres: outside of ordinary
    extents the near plane follows the cameras' extent.

    Args:
        cameras: of the scene; without any its unit is taken to be an ordinary one.
    """
    extent = camera_extent(cameras) if cameras else 1.0
    return NEAR if ORDINARY[0] <= extent <= ORDINARY[1] else SHARE * extent
