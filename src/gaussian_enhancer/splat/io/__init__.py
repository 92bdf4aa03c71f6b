"""Splat files: reading and writing of 3DGS .ply, PlayCanvas compressed .ply and .spz; reading of gsplat's results."""
