"""The artefacts of stage 1: one file each, pure functions from views to views."""
