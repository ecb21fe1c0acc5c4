"""Builds the compiled kernels where there is a C compiler; without one the package is installed without them."""

from __future__ import annotations

import os
import zlib
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

KERNELS = (
    "factors/_rows.pyx",
    "factors/_points.pyx",
    "factors/_silhouette.pyx",
    "factors/_energy.pyx",
    "factors/_shape.pyx",
    "fgrecon/solve/_native.pyx",
    "fgrecon/video/_egomotion.pyx",
)


class KernelHook(BuildHookInterface[Any]):
    """Compiles each kernel in place, so that an editable installation finds it as well."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:  # noqa: ARG002  # hatchling's signature
        """Compile, and tell hatchling of the files."""
        try:
            built = _compile(Path(self.root))
        except Exception as error:  # noqa: BLE001  # whatever compilers raise: the numpy versions do the work then
            self.app.display_warning(f"Installed without the compiled kernels, several times slower: {error}")
            return
        build_data["pure_python"] = False
        build_data["infer_tag"] = True
        build_data["artifacts"] += built


def _checksum(source: Path) -> int:
    """What `factors.native` compares with the sources that are there."""
    header = source.with_suffix(".pxd")
    return zlib.crc32(source.read_bytes() + (header.read_bytes() if header.exists() else b""))


def _compile(root: Path) -> list[str]:
    from Cython.Build import cythonize
    from setuptools import Distribution, Extension
    from setuptools.command.build_ext import build_ext

    # No -ffast-math: sums keep their order, and NaN stays NaN.
    flags = ["-O3", "-fno-math-errno", "-fno-trapping-math"] if os.name == "posix" else ["/O2"]
    before = Path.cwd()
    os.chdir(root)  # names of modules follow from paths
    try:
        extensions = [
            Extension(
                path.removesuffix(".pyx").replace("/", "."),
                [path],
                extra_compile_args=flags,
                define_macros=[("FGRECON_SOURCES", f"{_checksum(Path(path))}u")],
            )
            for path in KERNELS
        ]
        modules = cythonize(extensions, build_dir="build/cython", quiet=True)
        command = build_ext(Distribution({"ext_modules": modules}))
        command.inplace, command.build_temp, command.parallel = True, "build/kernel", os.cpu_count()
        command.ensure_finalized()
        command.run()
        built = [Path(command.get_ext_fullpath(module.name)).resolve() for module in modules]
        return ["/" + path.relative_to(root.resolve()).as_posix() for path in built]
    finally:
        os.chdir(before)
