"""The site: versions beside one another, a search that has every page, and buttons that copy code."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.conftest import REPOSITORY


@pytest.fixture
def project(tmp_path):
    """A repository with the site's configuration and two pages; without the reference, which takes a minute."""
    pytest.importorskip("mike", reason="mike is in the extra docs")
    (tmp_path / "docs").mkdir()
    (tmp_path / "docs/index.md").write_text("# Start\n\nWhere wombats are.\n\n```bash\nfgrecon demo\n```\n")
    configured = yaml.safe_load((REPOSITORY / "mkdocs.yml").read_text(encoding="utf-8"))
    names = ("site_name", "use_directory_urls", "theme", "extra", "markdown_extensions")
    short = {name: configured[name] for name in names} | {"plugins": ["search"]}
    (tmp_path / "mkdocs.yml").write_text(yaml.safe_dump(short))
    for words in ("init -q", "config user.name A", "config user.email a@b.example", "commit -q --allow-empty -m Start"):
        subprocess.run(["git", *words.split()], cwd=tmp_path, check=True)
    return tmp_path


@pytest.mark.slow
def test_each_release_has_its_site_with_search_and_copy_buttons(project):
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]])  # mike runs mkdocs

    def run(*words):
        mike = (sys.executable, "-c", "from mike.driver import main; main()")
        words = (*mike, *words[1:]) if words[0] == "mike" else words
        environment = {**os.environ, "PATH": path}
        return subprocess.run(words, cwd=project, check=True, capture_output=True, text=True, env=environment).stdout

    for version in ("0.1", "0.2"):
        run("mike", "deploy", "--update-aliases", version, "latest")
    run("mike", "set-default", "latest")
    versions = json.loads(run("git", "show", "gh-pages:versions.json"))
    assert [(one["version"], one["aliases"]) for one in versions] == [("0.2", ["latest"]), ("0.1", [])]
    assert "latest" in run("git", "show", "gh-pages:index.html")
    for version in ("0.1", "0.2"):
        page = run("git", "show", f"gh-pages:{version}/index.html")
        config = json.loads(
            page.partition('<script id="__config" type="application/json">')[2].partition("</script>")[0]
        )
        assert config["version"]["provider"] == "mike"
        assert "content.code.copy" in config["features"]
        found = json.loads(run("git", "show", f"gh-pages:{version}/search/search_index.json"))
        assert any("wombats" in entry["text"] for entry in found["docs"])
