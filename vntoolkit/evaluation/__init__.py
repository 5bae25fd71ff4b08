"""Floor 2, errors of results against references."""
