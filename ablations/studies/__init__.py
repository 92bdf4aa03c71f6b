"""Studies of our own: descriptions as YAML, metrics as Python."""
