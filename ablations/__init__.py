"""The experiment suite, its studies, and the reports that it makes from records."""
