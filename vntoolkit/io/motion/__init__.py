"""Motion capture and the fit of a garment to it."""
