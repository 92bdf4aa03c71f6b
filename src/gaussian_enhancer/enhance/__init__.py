"""The fusion network, knowing neither Lightning nor Hydra."""
