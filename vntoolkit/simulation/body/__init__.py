"""Bodies of tapered capsules and implicit surfaces, used by the sweater, spandex and head scenes."""
