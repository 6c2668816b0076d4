"""The TOML files: where they are (find), what they may say (schema, check), loaded into frozen specs (load)."""
