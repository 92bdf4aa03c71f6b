"""Roles of the scenes that studies of fits measure, as stated in docs/data.md."""

import pandas as pd

from gaussian_enhancer.errors import InputError
from gaussian_enhancer.scene.frozen import FROZEN_CAPTURES

ROLES = {
    "training": ("conch", "viking", "tumdesk", "panel17", "axe", "caliterra", "lewis", "boruszyn", "office", "buddha"),
    "validation": ("plush", "flowerpot", "cyprus", "banana", "copr"),
    "test": FROZEN_CAPTURES,
    "procedural": ("object_1000", "outdoor_1000", "unbounded_1000", "indoor_1000"),
}
"""Captures, and procedural validation scenes, by role."""


def role_of(scene: str) -> str:
    """Role of a scene: a key of `ROLES`.

    Raises:
        InputError: the scene has no role.
    """
    for role, names in ROLES.items():
        if scene in names:
            return role
    raise InputError(scene, "has no role", f"name the run by its capture: {', '.join(sum(ROLES.values(), ()))}")


def with_roles(frame: pd.DataFrame) -> pd.DataFrame:
    """The rows with the role of their scene.

    Args:
        frame: rows with a column "scene".
    """
    return frame.assign(role=frame["scene"].map(role_of))
