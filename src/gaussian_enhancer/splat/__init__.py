"""Gaussians and a camera to colour, depth and alpha; files in and out; fitting."""
