"""The Python API; its names are imported from ``gaussian_enhancer``."""
