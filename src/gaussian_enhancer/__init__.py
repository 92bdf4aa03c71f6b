"""Post-processor for Gaussian-splatting renders, and the experiment suite that proves it."""
