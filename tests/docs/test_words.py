"""Pages, messages, help and the public API use the project's words (CONTRIBUTING, "Words") and spell them right.

By codespell. Sentences of pages are short.
"""

import ast
import re
import subprocess
import sys
from pathlib import Path

import pytest

import fgrecon
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
MOST_WORDS_OF_ALL = 20000
"""Of pages that nothing generates, without blocks of code, numbers, history and model cards."""


def misspelt(*files, cwd=REPOSITORY):
    """What codespell finds in files: lines that name file and line, or nothing."""
    pytest.importorskip("codespell_lib", reason="codespell is in the extra dev")
    own = ["--dictionary", "-", "--dictionary", str(DOCS / "words.txt"), "--builtin", "clear,rare"]
    found = subprocess.run(
        [
            *(sys.executable, "-m", "codespell_lib", *own, "--regex", WORD, "--ignore-multiline-regex", CODE),
            *("--ignore-words-list", "nees", "--quiet-level", "2", *map(str, files)),
        ],
        check=False,
        capture_output=True,
        text=True,
        cwd=cwd,
    )
    assert found.returncode in (0, 65), found.stderr
    return found.stdout


def test_words_and_spelling_of_pages():
    assert misspelt(*PAGES) == ""


def read_by_users(path):
    """Lines of a module as long as it is, that have what users read: messages, help, docstrings of the public API."""
    source = path.read_text(encoding="utf-8")
    tree, shown = ast.parse(source), [""] * (source.count("\n") + 2)
    public = [node for node in tree.body if getattr(node, "name", "") in fgrecon.__all__ or "cli" in path.parts]
    docstrings, api = (
        {n.value for top in tops for n in ast.walk(top) if isinstance(n, ast.Expr)} for tops in ([tree], public)
    )
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and (node not in docstrings or node in api):
            for number, line in enumerate(node.value.splitlines()):
                if " " in line.strip():
                    shown[min(node.lineno - 1 + number, len(shown) - 1)] += f" {line}"
    return "\n".join(shown)


def test_words_and_spelling_of_messages_and_of_the_public_api(tmp_path):
    files = [
        path
        for root in ("fgrecon", "factors", "research/fgrecon_research")
        for path in REPOSITORY.glob(f"{root}/**/*.py")
    ]
    for path in files:
        copy = tmp_path / path.relative_to(REPOSITORY)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(read_by_users(path), encoding="utf-8")
    assert misspelt(".", cwd=tmp_path) == ""


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


def test_the_manual_is_short():
    pages = [page for page in PAGES if page.is_relative_to(DOCS) and not {"fields", "rooms.md"} & set(page.parts)]
    words = re.sub(r"^```.*?^```", "", "\n".join(map(Path.read_text, pages)), flags=re.DOTALL | re.MULTILINE).split()
    assert sum(bool(re.search(r"[A-Za-z]", word)) for word in words) <= MOST_WORDS_OF_ALL
