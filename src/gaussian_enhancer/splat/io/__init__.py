"""Splat files: 3DGS .ply in and out, PlayCanvas compressed .ply and .spz in."""
