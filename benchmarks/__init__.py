"""Speed, memory and accuracy of every stage, as a user meets them: `python -m benchmarks` runs them all."""

import vntoolkit.__main__  # noqa: F401 - tames the thread pools, before numpy is loaded
