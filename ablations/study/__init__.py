"""Measures studies, and computes the statistics of their tables from records."""
