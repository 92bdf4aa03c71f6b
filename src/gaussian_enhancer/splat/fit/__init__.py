"""Fitting a splat to photos."""
