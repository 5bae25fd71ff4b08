"""Floor 1, light: encoded values to linear ones, the light response M, the forward model."""
