"""Floor 2, how far a result is from a reference."""
