"""The page of tuned numbers is what its script makes of the settings classes."""

import runpy

from tests.conftest import REPOSITORY


def test_the_page_is_what_the_script_makes():
    made = runpy.run_path(str(REPOSITORY / "docs/settings.py"))["page"]()
    page = REPOSITORY / "docs/reference/settings.md"
    assert page.read_text(encoding="utf-8") == made, "run `python docs/settings.py`"
