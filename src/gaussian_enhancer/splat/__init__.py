"""Splats: rendering of colour, depth and alpha, file formats, and fitting."""
