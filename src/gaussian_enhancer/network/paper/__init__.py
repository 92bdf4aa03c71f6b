"""Our reading of the paper's networks (Zou et al., Symmetry 2025, 17(3), 442); see docs/fidelity.md."""
