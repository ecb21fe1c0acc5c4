"""What photographs say of their camera, and which way is up."""

from io import BytesIO

import numpy as np
import pytest
from PIL import Image

from fgrecon.io.images import EXIF_SIGMA, exif_camera, read_image, read_photograph

ORIENTATION, DETAILS = 0x0112, 0x8769
WIDTH, HEIGHT = 0xA002, 0xA003


def jpeg(tags, size=(600, 400), orientation=None):
    exif = Image.Exif()
    exif.get_ifd(DETAILS).update(tags)
    if orientation is not None:
        exif[ORIENTATION] = orientation
    picture = np.zeros((size[1], size[0], 3), dtype=np.uint8)
    picture[: size[1] // 2, : size[0] // 4] = 255  # white in the upper left corner
    file = BytesIO()
    Image.fromarray(picture).save(file, "JPEG", exif=exif, quality=95)
    return file.getvalue()


@pytest.mark.parametrize(
    ("tags", "focal"),
    [
        ({0xA405: 36}, 36 / 43.2666 * np.hypot(600, 400)),
        ({0x920A: 4.0, 0xA20E: 500.0, 0xA210: 4, WIDTH: 1200, HEIGHT: 800}, 4.0 * 500.0 / 2),  # shown at half its size
        ({0x920A: 4.0, 0xA20E: 5000.0, 0xA210: 3, WIDTH: 600, HEIGHT: 400}, 4.0 * 500.0),
    ],
    ids=["35 mm", "resized", "per centimetre"],
)
def test_the_focal_length(tags, focal):
    camera = exif_camera(jpeg(tags), 600, 400)
    assert camera.matrix[0, 0] == camera.matrix[1, 1] == pytest.approx(focal, rel=1e-5)
    assert camera.matrix[:2, 2].tolist() == [299.5, 199.5]
    assert (camera.focal_sigma, camera.image_size) == (EXIF_SIGMA, (600, 400))


@pytest.mark.parametrize(
    "tags",
    [
        {},
        {0xA405: 0},
        {0xA405: 20000},
        {0x920A: 4.0},
        {0xA405: 36, WIDTH: 1200, HEIGHT: 1000},
        {0x920A: 4.0, 0xA20E: 0.0, WIDTH: 600, HEIGHT: 400},
    ],
    ids=["nothing", "unknown", "absurd", "without the sensor", "cropped", "no density"],
)
def test_what_does_not_tell(tags):
    assert exif_camera(jpeg(tags), 600, 400) is None


@pytest.mark.parametrize("content", [b"", b"no picture", jpeg({0xA405: 36})[:60]], ids=["empty", "text", "cut off"])
def test_damaged_files_tell_nothing(content):
    assert exif_camera(content, 600, 400) is None


def test_damage_anywhere_is_no_error():
    whole = bytearray(jpeg({0xA405: 36, 0x920A: 4.0, WIDTH: 600, HEIGHT: 400}))
    rng = np.random.default_rng(0)
    for _ in range(300):
        damaged = bytearray(whole)
        for place in rng.integers(0, 200, size=4):
            damaged[place] = rng.integers(0, 256)
        exif_camera(bytes(damaged), 600, 400)


def test_photographs_are_upright(tmp_path):
    """A phone stores a picture held upright on its side, and says so."""
    path = tmp_path / "phone.jpg"
    path.write_bytes(jpeg({0xA405: 26}, orientation=6))  # to be turned by a quarter to the right
    image, camera = read_photograph(path)
    assert image.shape == (600, 400, 3)
    assert image[:140, 210:].min() > 200  # white is now at the upper right
    assert image[160:].max() < 60
    assert camera.image_size == (400, 600)
    np.testing.assert_array_equal(read_image(path), image)
