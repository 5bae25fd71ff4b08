"""Floor 1, light: transfer curves, the light response M, the forward model."""
