"""Measures error against run time, of methods at several settings, of trainings, and of kernels."""
