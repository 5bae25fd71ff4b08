"""Figure 10: a checkerboard on the sweater, tracked by each method side by side.

    python recipes/figure10.py --out out/figure10 [--frames 1000]  # 1000 frames: about 2 h; --quick 1 min

As figure08.py, on the simulated sweater.

checkerboards.png: moments of the second half, a column for each method.
errors.svg: median and 95th percentile of the error of the visible vertices, in pixels, by frame.
"""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import figure08

if __name__ == "__main__":  # takes --out, --frames and "--quick"
    figure08.run(__doc__, "figure10", "sweater")
