import dataclasses

import numpy as np
import pytest

from vntoolkit.errors import BadInput
from vntoolkit.evaluation.angular_error import AngleHistogram, summarise_angles


def test_parts_summarise_like_the_whole(rng: np.random.Generator) -> None:
    angles = np.concatenate([rng.rayleigh(6.0, 20000), [180.0, 0.0]])
    histogram = AngleHistogram()
    for part in np.array_split(angles, 7):
        histogram.add(part)
    ours, whole = (dataclasses.asdict(e) for e in (histogram.summary(), summarise_angles(angles)))
    for name, value in whole.items():
        assert ours[name] == pytest.approx(value, abs=0.011), name
    assert ours["mean_deg"] == pytest.approx(whole["mean_deg"], rel=1e-12)
    assert np.all(np.diff(histogram.values()) >= 0)


def test_nothing_to_summarise_is_refused() -> None:
    with pytest.raises(BadInput, match="no valid pixel"):
        AngleHistogram().summary()
