"""A human head: sculpted as an implicit surface, slit at lips and lids, moved by expressions."""
