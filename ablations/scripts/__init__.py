"""Single measurements, each a script."""
