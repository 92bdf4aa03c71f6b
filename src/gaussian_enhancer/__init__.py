"""Post-processor for Gaussian-splatting renders, and the experiment suite that proves it."""

import os

# Idle OpenMP threads spin by default: on a machine that others use too, a fit then takes 20 times as long
# (28 against 450-740 ms a step, measured). Where they sleep at once, waking them takes longer than most loops of an
# enhancement (250 against 140 ms a view, measured): they spin for a moment. Read once, when torch loads its OpenMP
# library.
if "OMP_WAIT_POLICY" not in os.environ:
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"
    os.environ.setdefault("GOMP_SPINCOUNT", "10000")
