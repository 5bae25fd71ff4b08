"""The small capture and the result folder that the live view is tested on."""

from tests.dome_result import dome_result
from tests.pipeline.conftest import dome_capture

__all__ = ["dome_capture", "dome_result"]
