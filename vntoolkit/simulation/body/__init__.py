"""Bodies of implicit surfaces, used by the spandex and head scenes."""
