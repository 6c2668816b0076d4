"""Schemas of files that are learned and that a user may read (docs/reference/files.md)."""
