"""Floor 2, which light reaches which pixel, and the normal where one does not."""
