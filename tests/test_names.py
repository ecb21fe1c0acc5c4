"""A name means one thing: no public class of the two packages shares its name with another."""

import ast

from .test_layers import FILES


def test_no_public_class_is_defined_twice():
    homes = {}
    for module, path in FILES.items():
        for node in ast.parse(path.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                homes.setdefault(node.name, []).append(module)
    assert {name: modules for name, modules in homes.items() if len(modules) > 1} == {}
