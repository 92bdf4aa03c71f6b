"""Alignment of references to the target's pixel grid: warps, depth refinement, exposure, photo-consistency."""
