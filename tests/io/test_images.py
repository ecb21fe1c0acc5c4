"""Reading and writing image files."""

import numpy as np
import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.images import read_image, write_png


def test_a_picture_comes_back_as_rgb(tmp_path):
    image = np.random.default_rng(0).integers(0, 256, (5, 7, 3), dtype=np.uint8)
    file = write_png(tmp_path / "image.png", image)
    assert np.array_equal(read_image(file), image)
    assert read_image(file).flags.c_contiguous


@pytest.mark.parametrize("content", [None, b"", b"GIF89a"], ids=["absent", "empty", "broken"])
def test_what_is_no_image_is_refused(tmp_path, content):
    file = tmp_path / "image.png"
    if content is not None:
        file.write_bytes(content)
    with pytest.raises(InvalidInputError, match=r"image\.png") as error:
        read_image(file)
    assert error.value.field == "image"
