"""The main job as a user runs it: every verb of the demonstration, then the page."""

import pytest

from vntoolkit.__main__ import main
from vntoolkit.pipeline.opened_result import read_result
from vntoolkit.pipeline.truth_comparison import compare_with_truth, light_errors_deg


@pytest.mark.slow
def test_the_demonstration_reconstructs_what_it_simulated(tmp_path, capsys):
    out = tmp_path / "demo"
    assert main(["demo", "--out", str(out), "--frames", "2"]) == 0
    printed = capsys.readouterr().out
    assert str(out / "report.html") in printed

    result = read_result(out / "reconstruction")
    assert light_errors_deg(result.rig.response, out / "sweater").max() < 2.0  # degrees, M's rows
    for frame in compare_with_truth(result, out / "sweater"):
        assert frame.normals.median_deg < 7.0  # near lights over 1.4 m and a knit of two pixels; measured 5.6
        assert frame.depth is not None
        assert frame.depth.mean_percent < 2.0
    page = (out / "report.html").read_text()
    assert "Against the truth" in page
    assert "http://" not in page.replace("http://www.w3.org/", "")  # a namespace is not a request

    before = (out / "reconstruction" / "depth" / "000001.exr").read_bytes()
    assert main(["demo", "--out", str(out), "--frames", "2"]) == 0  # goes on where nothing is left to do
    assert (out / "reconstruction" / "depth" / "000001.exr").read_bytes() == before
