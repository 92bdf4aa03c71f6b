"""Stiff and extreme cases: each computed in every precision, forward and backward, and held against float64."""
