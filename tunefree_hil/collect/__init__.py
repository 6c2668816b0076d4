"""Guided data collection: coverage of driving states, and a planner that drives the missing ones safely."""
