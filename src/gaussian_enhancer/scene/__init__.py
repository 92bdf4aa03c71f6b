"""Where truth comes from: procedural worlds, captures, folders of finished renders; splits; neighbour choice."""
