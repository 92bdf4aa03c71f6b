"""Error against run time: methods at several settings, trainings, kernels."""
