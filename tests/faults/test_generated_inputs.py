"""Generated rigs, seams, motion and lights: read as written, or refused with one line."""

import json

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from specimens import rig

from tests.motion_texts import BVH
from vntoolkit.errors import VntError
from vntoolkit.io.footage.frame_range import FrameRange
from vntoolkit.io.light_files import read_lights
from vntoolkit.io.motion.bvh import read_bvh
from vntoolkit.io.results.seams import read_seams
from vntoolkit.io.rigs import rig_from_text, text_from_rig
from vntoolkit.photometry.transfer import Transfer

quick = settings(
    max_examples=40,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
numbers = st.one_of(st.floats(), st.integers(), st.sampled_from([1e308, -0.0, 2**70]))
anything = st.recursive(
    st.one_of(st.none(), st.booleans(), numbers, st.text(max_size=8)),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=8), inner, max_size=4),
    max_leaves=12,
)  # fmt: skip


def one_line_or(read, *arguments):
    """Return what was read, or None after an error of one line."""
    try:
        return read(*arguments)
    except VntError as error:
        line = str(error)
    assert line.strip()
    assert "\n" not in line
    assert len(line) < 1000
    return None


@quick
@given(st.data())
def test_rigs_with_any_value_anywhere(data):
    content = json.loads(text_from_rig(rig()))
    section = data.draw(st.sampled_from(sorted(content)))
    place = content
    if isinstance(content[section], dict) and data.draw(st.booleans()):
        place = content[section]
        section = data.draw(st.sampled_from(sorted(place)))
    place[section] = data.draw(anything)
    read = one_line_or(rig_from_text, json.dumps(content), "rig.json")
    if read is not None:
        assert np.isfinite(read.response.inverse).all()
        assert one_line_or(rig_from_text, text_from_rig(read), "again") is not None


@quick
@given(content=st.one_of(anything, st.builds(lambda seams: {"seams": seams}, anything)))
def test_seams_of_any_shape(tmp_path, content):
    path = tmp_path / "seams.json"
    path.write_text(json.dumps(content))
    for seam in one_line_or(read_seams, path) or ():
        assert seam.shape[1] == 2
        assert np.isfinite(seam).all()


@quick
@given(points=st.lists(st.lists(st.tuples(*[st.floats(-1e4, 1e4)] * 2), min_size=2, max_size=5), max_size=3))
def test_sound_seams_are_read_as_written(tmp_path, points):
    path = tmp_path / "seams.json"
    path.write_text(json.dumps({"seams": points}))
    assert [seam.tolist() for seam in read_seams(path)] == [[list(p) for p in seam] for seam in points]


@quick
@given(st.data())
def test_motion_with_any_word_anywhere(tmp_path, data):
    words = BVH.split(" ")
    for _ in range(data.draw(st.integers(1, 3))):
        at = data.draw(st.integers(0, len(words) - 1))
        words[at] = data.draw(st.one_of(st.text(max_size=6), numbers.map(str), st.sampled_from(BVH.split())))
    path = tmp_path / "a.bvh"
    path.write_text(" ".join(words), encoding="utf-8", errors="surrogatepass")
    read = one_line_or(read_bvh, path)
    assert read is None or np.isfinite(read.rotations).all()


@quick
@given(rows=st.lists(st.lists(numbers, max_size=7), max_size=5))
def test_lights_of_any_number(tmp_path, rows):
    path = tmp_path / "lights.txt"
    path.write_text("\n".join(" ".join(map(str, row)) for row in rows))
    read = one_line_or(read_lights, path)
    assert read is None or np.isfinite(read.directions).all()


@quick
@given(st.text(max_size=12))
def test_options_of_any_text(text):
    one_line_or(Transfer.from_text, text)
    one_line_or(FrameRange.from_text, text)
