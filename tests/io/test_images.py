"""Reading and writing image files."""

import cv2
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


@pytest.mark.parametrize("bits", [8, 10, 12, 14, 16])
def test_of_sixteen_bits_those_that_a_camera_uses(tmp_path, bits):
    """Ten to fourteen bits of a camera in files of sixteen are not nearly black."""
    shown = np.random.default_rng(0).integers(0, 256, (20, 30, 3), dtype=np.uint8)
    shown[0, 0] = 255
    cv2.imwrite(str(tmp_path / "deep.png"), cv2.cvtColor(shown, cv2.COLOR_RGB2BGR).astype(np.uint16) << (bits - 8))
    np.testing.assert_array_equal(read_image(tmp_path / "deep.png"), shown)
