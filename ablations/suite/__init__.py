"""Tables and studies from nothing to their records."""
