"""Floor 2, skinning: a moving mesh attached to an animated skeleton."""
