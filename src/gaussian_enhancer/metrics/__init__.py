"""Image quality and cost, and the records of measurements."""
