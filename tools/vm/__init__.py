"""What `tools/vcan_vm` is made of. The standard library only: it runs before any environment is installed."""
