"""What the documentation says about the code is so: commands, options, rooms, states, links and figures."""

import ast
import re
import runpy
import shlex

import pytest
import typer

import fgrecon
from fgrecon.cli import main
from tests.conftest import REPOSITORY
from tests.docs.pages import PAGES, blocks, commands, name_of, rows

TABLES = REPOSITORY / "docs/tables"


def named(command):
    """Names of what a group has; of a command none."""
    return command.list_commands(None) if hasattr(command, "list_commands") else []


def leaf(words):
    """The command that words name, and the words that are left."""
    command = typer.main.get_command(main.app)
    while words and words[0] in named(command):
        command, words = command.get_command(None, words[0]), words[1:]
    return command, words


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_every_command_and_option_exists(page):
    for line in commands(page.read_text(encoding="utf-8")):
        command, rest = leaf(shlex.split(line)[1:])
        assert not named(command) or rest[0].startswith("--"), line
        known = {
            "--help",
            *(name for parameter in command.params for name in (*parameter.opts, *parameter.secondary_opts)),
        }
        assert {word for word in rest if re.match("--?[a-z]", word)} <= known | {"--install-completion"}, line


@pytest.mark.parametrize("page", [p for p in PAGES if "docs" not in p.parts[-3:]], ids=name_of)
def test_links_lead_somewhere(page):
    links = re.findall(r"\]\(([^)#]+)[^)]*\)", page.read_text(encoding="utf-8"))
    assert [link for link in links if not link.startswith("http") and not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_python_is_python(page):
    for block in blocks(page.read_text(encoding="utf-8"), "python"):
        ast.parse(block)


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_no_table_is_broken_by_an_empty_line(page):
    lines = re.sub(r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE).splitlines()
    firsts = [i for i, line in enumerate(lines) if line.startswith("|") and not lines[i - 1].startswith("|")]
    assert [lines[i] for i in firsts if not re.match(r"\|[ :]*---", lines[i + 1])] == []


def test_the_rooms_are_those_that_are_checked():
    made = runpy.run_path(str(REPOSITORY / "docs/rooms.py"))["page"]()
    assert (REPOSITORY / "docs/reference/rooms.md").read_text(encoding="utf-8") == made, "run `python docs/rooms.py`"


def test_the_options_shown_are_the_defaults():
    known = {}
    (block,) = blocks((REPOSITORY / "docs/reference/options.md").read_text(encoding="utf-8"), "python")
    exec(block, known)
    assert known["options"] == fgrecon.Options()


def test_every_status_is_explained():
    text = (REPOSITORY / "docs/reference/result.md").read_text(encoding="utf-8")
    table = text.partition("## Status\n\n")[2].partition("\n\n")[0]  # others of the section tell what makes it so
    status = [row[0].strip("`") for row in rows(table)[2:]]
    assert status == [str(status) for status in fgrecon.Status]


@pytest.mark.parametrize("table", sorted(TABLES.glob("*.md")), ids=lambda path: path.stem)
def test_a_table_says_how_it_was_made(table):
    source = ast.parse((REPOSITORY / "docs/measure.py").read_text(encoding="utf-8"))
    made = {node.name for node in source.body if isinstance(node, ast.FunctionDef)}
    head = table.read_text(encoding="utf-8").splitlines()[0]
    assert head.startswith(f"*`python docs/measure.py {table.stem} --data DATA` (fgrecon ")
    assert table.stem in made


def test_the_figures_of_the_readme_are_those_of_the_tables():
    made = [
        set(row) for name in ("tracks", "kitti") for row in rows((TABLES / f"{name}.md").read_text(encoding="utf-8"))
    ]
    text = (REPOSITORY / "README.md").read_text(encoding="utf-8").partition("## Accuracy")[2].partition("\n## ")[0]
    shown = [row for row in rows(text) if row[0] not in ("method", "boxes") and not row[0].startswith("---")]
    assert len(shown) >= 6
    assert [row for row in shown if not any(set(row) <= cells for cells in made)] == []


def test_a_folder_of_results_has_one_content():
    """Whoever tries one page after the other in one folder is not refused: a batch's folder is for one kind of run."""
    filled = {}
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for words in map(shlex.split, commands(text)):
            if words[1] in ("batch", "run") and "--out" in words:
                out = words.index("--out") + 1
                inputs = tuple(words[2:out]) if words[1] == "batch" else words[2]
                filled.setdefault(words[out], set()).add((words[1], inputs))
        for block in (*blocks(text, "python"), *blocks(text, "py")):
            found = re.findall(r'(?:sources_of\(.*?\), |frame_detector, follower, Path\()"(\w+)"', block)
            for name in found:
                filled.setdefault(name, set()).add(("python", block))
    assert {"sized", "solved", "followed", "tracked"} <= set(filled)
    assert {name: inputs for name, inputs in filled.items() if len(inputs) > 1} == {}


@pytest.mark.parametrize("page", sorted((REPOSITORY / "docs/how-to").glob("*.md")), ids=name_of)
def test_a_guide_is_one_task(page):
    assert len(page.read_text(encoding="utf-8").split()) <= 400
