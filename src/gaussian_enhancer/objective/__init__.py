"""Unreduced loss terms and their named, weighted sum."""
