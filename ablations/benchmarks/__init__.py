"""Timings of kernels and networks."""
