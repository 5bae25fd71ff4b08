"""The small capture that the live view is tested on."""

from tests.pipeline.conftest import dome_capture

__all__ = ["dome_capture"]
