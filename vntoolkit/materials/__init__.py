"""Materials: how much each one returns of every lamp, and which pixels are of it."""
