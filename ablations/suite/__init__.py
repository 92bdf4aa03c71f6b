"""Plans and makes the runs behind tables and studies, up to their records."""
