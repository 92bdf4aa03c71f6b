"""Four families of procedural worlds with exact depth at any resolution."""
