"""What the networks are compared with, behind the same interface and at the same budgets."""
