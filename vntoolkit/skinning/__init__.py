"""Floor 2, the moving mesh on an animated skeleton."""
