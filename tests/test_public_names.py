import importlib.util

import pytest

import vntoolkit


@pytest.mark.parametrize("name", vntoolkit.__all__)
def test_every_public_name_is_there(name: str) -> None:
    assert getattr(vntoolkit, name) is not None


def test_an_unknown_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'nothing_of_the_kind'"):
        vntoolkit.nothing_of_the_kind  # noqa: B018


def test_importing_the_package_imports_no_stage() -> None:
    assert importlib.util.find_spec("vntoolkit.integration") is not None
    source = importlib.util.find_spec("vntoolkit").loader.get_source("vntoolkit")
    assert "\nfrom vntoolkit" not in source
