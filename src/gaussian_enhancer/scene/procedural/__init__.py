"""Five families of procedural scenes with exact depth at any resolution."""

from gaussian_enhancer.scene.procedural.source import FAMILIES, procedural_scene

__all__ = ["FAMILIES", "procedural_scene"]
