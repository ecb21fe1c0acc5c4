"""The licences page has every package that is needed, and every weight and prior that is shipped."""

import re
import tomllib
from itertools import chain

import pytest

from tests.conftest import REPOSITORY

PAGE = (REPOSITORY / "docs/reference/licences.md").read_text()


def needed():
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]
    lists = [project["dependencies"], *project["optional-dependencies"].values()]
    names = {re.match(r"[\w.-]+", one).group() for one in chain.from_iterable(lists)}
    return sorted(names - {"fgrecon"})


@pytest.mark.parametrize("name", needed())
def test_every_package_has_a_licence(name):
    assert re.search(rf"[|,;] {re.escape(name)}[ ,;]", PAGE)


def test_every_shipped_file_has_terms():
    data = REPOSITORY / "fgrecon" / "data"
    files = [*data.glob("priors/*.npz"), *data.glob("weights/*.safetensors"), *data.glob("weights/*.onnx")]
    assert len(files) >= 7
    for file in files:
        assert file.name in PAGE
