"""Gates: which artefacts a sample gets, and how strongly."""
