"""Bodies of tapered capsules and implicit surfaces: what a garment hangs on and what a head is made of."""
