"""Loss terms without reduction, and their weighted sum."""
