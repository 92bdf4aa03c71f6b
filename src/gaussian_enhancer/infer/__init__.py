"""Inference: enhancement of sets of views, tiling, planning, temporal smoothing, presets and weights files."""
