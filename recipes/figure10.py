"""Figure 10: a checkerboard on the face, tracked by each method side by side.

    python recipes/figure10.py --out out/figure10 [--frames 1000]  # 1000 frames: about 2 h

As figure08.py, on the simulated face.
"""

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))
import figure08


def main(out: Path, frames: int = 1000) -> None:
    """Write sheets, videos and tables into the folder `out`."""
    figure08.main(out, frames, scene="face")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--frames", type=int, default=1000)
    arguments = parser.parse_args()
    main(arguments.out, arguments.frames)
