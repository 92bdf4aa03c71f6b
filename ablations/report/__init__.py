"""Tables, diagrams and pages of studies, from records only."""
