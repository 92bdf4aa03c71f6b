"""Run folders: their address, their status, and finding them again."""
