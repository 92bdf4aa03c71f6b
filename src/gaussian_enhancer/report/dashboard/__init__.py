"""The suite's dashboard: a static page from descriptions and records alone, with pictures beside it."""
