"""Thin Lightning modules and data modules."""
