"""Fusion networks (SIF, SSIF-LR, SSIF-SR), the cascade, their stages, and baselines."""
