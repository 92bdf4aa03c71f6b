"""Stiff and extreme cases: each computed in every precision, forward and backward, and compared with float64."""
