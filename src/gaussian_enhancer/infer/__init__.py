"""Inference: the enhancer of a set, tiles, plan, temporal smoothing, presets and weights."""
