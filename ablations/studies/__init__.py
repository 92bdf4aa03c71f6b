"""Studies of our own: descriptions as YAML, measures as Python."""
