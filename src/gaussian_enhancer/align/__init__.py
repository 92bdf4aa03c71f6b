"""References brought to the target's pixel grid: warp, reprojection, depth, exposure, photo-consistency."""
