"""Scenes: procedural worlds, captures, folders of renders, splits, and the choice of neighbouring photos."""
