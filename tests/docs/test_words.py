"""The pages use the project's words (CONTRIBUTING, "Words") and spell them right, by codespell; sentences are short."""

import re
import subprocess
import sys

import pytest

from tests.conftest import REPOSITORY
from tests.docs.pages import name_of

DOCS = REPOSITORY / "docs"
PAGES = [
    REPOSITORY / "README.md",
    *sorted(
        page
        for page in DOCS.rglob("*.md")
        if not {"history", "tables", "models"} & set(page.relative_to(DOCS).parts)
        and page.name not in ("settings.md", "changelog.md", "contributing.md")
    ),
]
"""Pages for users that people write: settings come from the code, model cards and history have their own time."""
PHRASES = r"turn(?:ed|s) round|asked for|the wrong way round|in the place of|one's own|no more than|that is wanted"
WORD = rf"(?i:{PHRASES})|[\w\-'’]+"
CODE = r"```.*?```|`[^`\n]*`|\]\([^)]*\)"
MOST_WORDS = 14.0
"""In a sentence, on average over a page."""


def test_words_and_spelling():
    pytest.importorskip("codespell_lib", reason="codespell is in the extra dev")
    own = ["--dictionary", "-", "--dictionary", str(DOCS / "words.txt"), "--builtin", "clear,rare"]
    found = subprocess.run(
        [
            *(sys.executable, "-m", "codespell_lib", *own, "--regex", WORD, "--ignore-multiline-regex", CODE),
            *("--ignore-words-list", "nees", "--quiet-level", "2", *map(str, PAGES)),
        ],
        check=False,
        capture_output=True,
        text=True,
    )
    assert (found.returncode, found.stdout) == (0, ""), found.stdout + found.stderr


def sentences(text):
    """Sentences of a page's prose, without code, tables, headings and pictures."""
    prose = re.sub(r"^```.*?^```", "", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for line in prose.splitlines() if not line.startswith(("#", "|", "!", "--8<--", "<!--", ":::"))]
    parts = re.split(r"(?<=[.:;?!])\s+|\n\n|^[-*\d]+\.? ", "\n".join(lines), flags=re.MULTILINE)
    return [part.split() for part in parts if len(part.split()) > 2]


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_sentences_are_short(page):
    found = sentences(page.read_text(encoding="utf-8"))
    if len(found) > 5:
        assert sum(map(len, found)) / len(found) <= MOST_WORDS
