"""What is public: every name of a package's face can be imported, is documented, and is what examples import."""

import ast
import importlib
import inspect
import subprocess
import sys

import pytest

import fgrecon

from .conftest import REPOSITORY

FACES = (
    "fgrecon",
    "fgrecon.batch",
    "fgrecon.errors",
    "fgrecon.io.export",
    "fgrecon.perception",
    "fgrecon.perception.keypoints",
    "fgrecon.simulation",
    "fgrecon.solve",
    "fgrecon.video",
    "fgrecon.viz",
)
ALLOWED = {*FACES, "factors"}
"""What examples may import from."""


def imported_names(package):
    """Names that a package's face imports from its modules, for type checkers alone or at once."""
    tree = ast.parse(inspect.getsource(importlib.import_module(package)))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    return {
        alias.asname or alias.name
        for node in imports
        if node.module.startswith(("fgrecon.", "factors.")) and node.module != "factors.lazy"
        for alias in node.names
    }


@pytest.mark.parametrize("package", FACES)
def test_every_public_name_is_there_and_documented(package):
    module = importlib.import_module(package)
    assert inspect.getdoc(module)
    for name in module.__all__:
        value = getattr(module, name)
        if inspect.isclass(value) or inspect.isroutine(value):
            assert value.__doc__, name
            assert not value.__doc__.startswith(f"{name}("), f"{name}: a docstring that dataclass made"


@pytest.mark.parametrize("package", FACES)
def test_the_face_names_what_it_imports(package):
    module = importlib.import_module(package)
    assert imported_names(package) == set(module.__all__)
    assert set(module.__all__) <= set(dir(module))


@pytest.mark.parametrize("package", ["fgrecon", "fgrecon.perception", "fgrecon.simulation"])
def test_no_lazy_name_is_a_submodule_as_well(package):
    """Importing the submodule would put the module in the name's place."""
    folder = REPOSITORY.joinpath(*package.split("."))
    modules = {path.stem for path in folder.iterdir() if path.suffix == ".py" or (path / "__init__.py").is_file()}
    assert not modules & set(importlib.import_module(package).__all__)


def test_the_version_is_the_installed_one():
    assert fgrecon.__version__ == importlib.metadata.version("fgrecon")
    assert fgrecon.__version__[0].isdigit()


def test_errors_are_there_without_an_import_of_their_own():
    code = "import fgrecon; print(fgrecon.errors.InvalidInputError.__name__)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "InvalidInputError"


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="nonsense"):
        fgrecon.nonsense  # noqa: B018


@pytest.mark.parametrize("module", ["fgrecon.perception", "fgrecon.simulation"])
def test_faces_cost_nothing(module):
    code = f"import sys, {module}; print([n for n in ('torch', 'cv2', 'scipy', 'gtsam', 'numpy') if n in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


@pytest.mark.parametrize("example", sorted((REPOSITORY / "examples").glob("*.py")), ids=lambda path: path.stem)
def test_examples_import_from_faces(example):
    tree = ast.parse(example.read_text())
    names = {node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)}
    ours = {name for name in names if name.partition(".")[0] in ("fgrecon", "factors")}
    assert ours <= ALLOWED
