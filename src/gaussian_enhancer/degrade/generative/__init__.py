"""Stage 2: learnt degradation factors."""
