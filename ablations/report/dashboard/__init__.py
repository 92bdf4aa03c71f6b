"""Makes the dashboard, a static page, from descriptions and records alone."""
