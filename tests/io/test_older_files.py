"""Files that earlier versions of the program wrote: read as what they say, or refused by name.

`old/` holds one rig of every earlier version, and a manifest of version 1, each written by the program of its
time.
"""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from vntoolkit.errors import BadInput, BadRig
from vntoolkit.io.results.manifest import MANIFEST_NAME, read_manifest
from vntoolkit.io.rigs import RIG_VERSION, read_rig, rig_from_text, text_from_rig

OLD = Path(__file__).parent / "old"


@pytest.mark.parametrize("version", range(1, RIG_VERSION))
def test_a_rig_of_an_earlier_version_says_what_it_said(version: int) -> None:
    path = OLD / f"rig-{version}.json"
    content, rig = json.loads(path.read_text()), read_rig(path)
    assert content["version"] == version
    np.testing.assert_array_equal(rig.response.matrix, content["response"]["matrix"])
    np.testing.assert_array_equal(rig.camera.matrix, content["camera"]["K"])
    assert (rig.response.variation is not None) == ("variation" in content["response"])
    assert (rig.response.light_doubts_deg is not None) == ("light_doubts_deg" in content["response"])
    assert (rig.gel is not None) == ("gel" in content)
    assert rig.material == content["response"].get("material", "")
    assert text_from_rig(rig_from_text(text_from_rig(rig))) == text_from_rig(rig)


def test_terms_that_an_early_gel_does_not_have_are_zero() -> None:
    stated = np.array(json.loads((OLD / "rig-3.json").read_text())["gel"]["coefficients"])
    gel = read_rig(OLD / "rig-3.json").gel
    assert gel is not None
    assert len(gel.coefficients) > len(stated)
    kept = gel.coefficients[gel.coefficients.any(axis=1)]
    np.testing.assert_array_equal(np.sort(kept, axis=None), np.sort(stated[stated.any(axis=1)], axis=None))


def test_a_rig_of_a_later_version_is_refused_by_its_number() -> None:
    content = json.loads((OLD / "rig-1.json").read_text()) | {"version": RIG_VERSION + 1}
    with pytest.raises(
        BadRig, match=f"is of version {RIG_VERSION + 1}, this program reads 1 to {RIG_VERSION}"
    ):
        rig_from_text(json.dumps(content))


def test_results_of_an_earlier_version_are_refused_with_the_remedy(tmp_path: Path) -> None:
    shutil.copy(OLD / "reconstruction-1.json", tmp_path / MANIFEST_NAME)
    with pytest.raises(BadInput, match="is of version 1, this program reads 2; reconstruct again"):
        read_manifest(tmp_path)
