"""Pictures of the reproduction, with the axes and panels of the paper."""
