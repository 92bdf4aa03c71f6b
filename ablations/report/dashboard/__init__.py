"""The dashboard: a static page made from descriptions and records alone."""
