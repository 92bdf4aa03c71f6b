"""Post-processor for Gaussian-splatting renders, and the experiment suite that proves it."""

import os

# Idle OpenMP threads spin by default: on a machine that others use too, a fit then takes 20 times as long
# (28 against 450-740 ms a step, measured). Read once, when torch loads its OpenMP library.
os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
