"""Baselines: networks and resamplers that the fusion networks are compared with."""
