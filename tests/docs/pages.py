"""The pages of the documentation, and the blocks of code in them."""

import re

from tests.conftest import REPOSITORY

PAGES = [
    REPOSITORY / "README.md",
    REPOSITORY / "CONTRIBUTING.md",
    *sorted(path for path in (REPOSITORY / "docs").rglob("*.md") if path.parent.name != "tables"),
    *sorted((REPOSITORY / "fgrecon/data").rglob("*.md")),
]


def name_of(path):
    """Path of a page from the repository's root."""
    return path.relative_to(REPOSITORY).as_posix()


def blocks(text, language):
    """Code blocks of a language, in order."""
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.DOTALL | re.MULTILINE)


def commands(text):
    """Lines of shell blocks that run `fgrecon`, without their comments; continued lines are one."""
    lines = "\n".join(blocks(text, "bash")).replace("\\\n", " ").splitlines()
    return [line.split("  #")[0].strip() for line in lines if line.startswith("fgrecon ")]


def rows(text):
    """Cells of every line of the Markdown tables, heads included."""
    return [
        [cell.strip() for cell in line.strip("| ").split(" | ")] for line in text.splitlines() if line.startswith("|")
    ]


def fenced(text):
    """Language and text of every code block of a page, in the order of the page."""
    return re.findall(r"^```(\w*)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
