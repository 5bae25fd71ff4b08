"""A knitted garment: its sewing pattern, a position-based cloth solver, smooth refinement."""
