"""Gates: selection of the artefacts of a sample and of their strengths."""
