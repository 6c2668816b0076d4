"""The TOML files: found (find), checked (schema, check) and loaded into frozen specs (load)."""
