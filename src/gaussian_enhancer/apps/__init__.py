"""One short Hydra entry point a job."""
