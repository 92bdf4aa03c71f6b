"""The jobs of this package, one module each."""
