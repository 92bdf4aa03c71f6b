"""From records to the statistics of a table."""
