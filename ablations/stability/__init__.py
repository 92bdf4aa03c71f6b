"""The stability matrix: extreme cases in every precision, forward and backward, compared with float64."""
