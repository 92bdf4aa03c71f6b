"""Baselines: networks and resampling methods with which the fusion networks are compared."""
