"""The processes of the bench: ECU, controller, and the runner that conducts an episode. Blocks in, frames out."""
