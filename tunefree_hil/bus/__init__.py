"""The bus: frames and their meaning."""
