"""Training with torch, which only this package imports; trained plants run without it."""
