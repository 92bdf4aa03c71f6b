"""Frames of a camera path: rendering in a pipeline, storage on disk, layout, and encoding."""
