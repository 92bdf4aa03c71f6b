"""Frames of a camera path: rendered ahead, kept on disk, laid out, and encoded."""
