"""Options that only the commands of this package have."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

MarkdownOption = Annotated[
    Path | None, typer.Option("--markdown", metavar="FILE", help="Write the tables as Markdown.")
]
ResultsOption = Annotated[
    Path | None,
    typer.Option("--results", metavar="FOLDER", help="Write the boxes as KITTI's results, for `evaluate boxes`."),
]
DataOption = Annotated[Path, typer.Option(metavar="FOLDER", envvar="FGRECON_DATA", help="Folder of the data.")]
DATA = Path("../shared/data")
"""Where the data are by default."""
