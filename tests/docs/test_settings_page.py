"""The tables of tuned numbers, options and fields of results are what their script makes of the classes."""

import runpy

from tests.conftest import REPOSITORY


def test_the_pages_are_what_the_script_makes():
    for name, make in runpy.run_path(str(REPOSITORY / "docs/settings.py"))["PAGES"].items():
        page = REPOSITORY / "docs/reference" / name
        assert page.read_text(encoding="utf-8") == make(), "run `python docs/settings.py`"
