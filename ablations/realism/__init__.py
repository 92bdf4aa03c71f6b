"""How close simulated renders are to real ones."""
