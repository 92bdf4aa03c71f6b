"""One short file a job of the lab."""
