"""Runs of jobs: their folders, their input and output, and the objects that configurations name."""
