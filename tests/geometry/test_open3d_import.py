"""Open3D's plots come with a web server; it is imported when they are called, and they then work as ever."""

import subprocess
import sys

SCRIPT = """
import sys
from vntoolkit.native import import_open3d
o3d = import_open3d()
assert "dash" not in sys.modules
box = o3d.geometry.TriangleMesh.create_box()
for _ in range(2):
    figure = o3d.visualization.get_plotly_fig([box])
    assert len(figure.data) == 1
assert o3d.visualization.draw_plotly.__module__ == "open3d.visualization.draw_plotly"
"""


def test_plots_of_open3d_are_imported_when_called() -> None:
    subprocess.run([sys.executable, "-c", SCRIPT], check=True)
