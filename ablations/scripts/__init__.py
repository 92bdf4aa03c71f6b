"""Single measurements, each a job."""
