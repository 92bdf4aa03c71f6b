"""Distilling of enhanced views into a splat: new cameras, confidence maps, further optimisation, and pruning."""
