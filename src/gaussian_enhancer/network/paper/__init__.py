"""The networks of the paper, line by line (Zou et al., Symmetry 2025, 17(3), 442); see docs/fidelity.md."""
