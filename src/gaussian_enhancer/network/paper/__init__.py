"""The paper's own networks, line by line (Zou et al., Symmetry 2025, 17(3), 442); see docs/fidelity.md."""
