"""Makes tables, diagrams and pages of studies from records alone."""
