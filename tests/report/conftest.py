"""The small result folder that the pages are about."""

from tests.dome_result import dome_result

__all__ = ["dome_result"]
