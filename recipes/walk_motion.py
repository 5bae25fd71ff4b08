"""The walk that the project ships, written anew: `data/walk.bvh`.

    python recipes/walk_motion.py --out data        # 1 s

Sines, no captured person: four strides of a figure 1.73 m tall, in centimetres, at 60 Hz.
"""

import argparse
from pathlib import Path

from vntoolkit.io.motion.bvh import write_bvh
from vntoolkit.skinning.gait import walking_motion


def main(out: Path) -> None:
    """Write `walk.bvh` into the folder `out`."""
    write_bvh(out / "walk.bvh", walking_motion())


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, default=Path("data"), help="folder to write")
    main(parser.parse_args().out)
