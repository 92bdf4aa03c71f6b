"""A better splat from enhanced views: new cameras, their confidence, further steps, pruning by free space."""
