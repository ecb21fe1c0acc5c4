"""Hashes of files, by which one sees whether they are what they were."""

import hashlib

import pytest

from fgrecon.core.errors import InvalidInputError
from fgrecon.io.files import file_hash


def test_the_hash_is_of_the_content(tmp_path):
    (tmp_path / "a").write_bytes(content := b"x" * 300_000)
    assert file_hash(tmp_path / "a") == hashlib.sha256(content).hexdigest()
    for path in (tmp_path, tmp_path / "none"):
        with pytest.raises(InvalidInputError, match="can be read"):
            file_hash(path)
