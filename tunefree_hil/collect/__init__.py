"""Guided collection: which driving is still missing, and a planner that drives it safely."""
