"""Speed, memory and accuracy of every stage with default options: `python -m benchmarks` runs all."""

import vntoolkit.__main__  # noqa: F401 - tames the thread pools, before numpy is loaded
