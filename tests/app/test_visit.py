"""What an uploaded file is, and which files belong together."""

import pytest

from fgrecon.app.solving import Uploaded
from fgrecon.app.upload_kinds import Kind, kind_of, safe_name
from fgrecon.app.visit import Upload
from fgrecon.core.errors import FgreconError

PHOTO, KEYPOINTS, NAMED = b"pixels", b'{"instances": []}', b'{"instances": [{"image": "a.png"}]}'


def uploaded(*files):
    upload = Upload(Uploaded(""), {})
    for name, content in files:
        upload = upload.with_file(kind_of(name, content), name, content)
    assert set(upload.files) == {n for n in vars(upload.names).values() if n}
    return upload.names


@pytest.mark.parametrize(
    ("name", "content", "kind"),
    [
        *(("a.JPG", b"", Kind.PHOTOGRAPH), ("a.mp4", b"", Kind.VIDEO), ("c.yaml", b"", Kind.CAMERA)),
        *(("c.txt", b"P0: 7 0", Kind.CAMERA), ("b.txt", b"Car 0.0 0 1.5", Kind.BOXES), ("b.txt", b"", Kind.BOXES)),
        *(("k.json", KEYPOINTS, Kind.KEYPOINTS), ("k.json", b'[{"bbox": [1]}]', Kind.BOXES)),
        *(("k.json", b'{"K": []}', Kind.CAMERA), ("k.json", b"[[[", Kind.KEYPOINTS)),
    ],
)
def test_kinds(name, content, kind):
    assert kind_of(name, content) == kind


def test_what_is_nothing_is_refused():
    with pytest.raises(FgreconError, match="no known kind"):
        kind_of("a.exe", b"MZ")


@pytest.mark.parametrize(
    ("name", "safe"),
    [
        *(("../../etc/passwd", "passwd"), ("a\\b\\c.png", "c.png"), (".png", "png"), ("..", "file"), ("", "file")),
        *(("<b>x.png", "_b_x.png"), ("a" * 300 + ".png", "a" * 96 + ".png"), ("a\0.png", "a_.png")),
    ],
)
def test_names_are_names_of_files_and_no_paths(name, safe):
    assert safe_name(name) == safe


def test_files_that_belong_together():
    assert uploaded(("a.png", PHOTO), ("c.yaml", b"")) == Uploaded("a.png", camera="c.yaml")
    assert uploaded(("c.yaml", b""), ("a.png", PHOTO), ("b.png", PHOTO)) == Uploaded("b.png", camera="c.yaml")
    assert uploaded(("b.txt", b"Car"), ("a.png", PHOTO)) == Uploaded("a.png", boxes="b.txt")
    assert uploaded(("a.png", PHOTO), ("b.txt", b"Car")) == Uploaded("a.png", boxes="b.txt")
    assert uploaded(("a.png", PHOTO), ("b.txt", b"Car"), ("z.png", PHOTO)) == Uploaded("z.png")


def test_keypoints_are_drawn_on_their_photograph():
    assert uploaded(("a.png", PHOTO), ("k.json", KEYPOINTS)) == Uploaded("k.json", photograph="a.png")
    assert uploaded(("a.png", PHOTO), ("k.json", NAMED)) == Uploaded("k.json", photograph="a.png")
    assert uploaded(("b.png", PHOTO), ("k.json", NAMED)) == Uploaded("k.json")
    assert uploaded(("k.json", NAMED), ("a.png", PHOTO)) == Uploaded("k.json", photograph="a.png")
    assert uploaded(("k.json", KEYPOINTS), ("a.png", PHOTO)) == Uploaded("a.png")
