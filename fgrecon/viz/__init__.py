"""Recordings and pictures of a reconstruction, made after solving from its history.

Nothing that computes imports this package, so a solve that is not drawn pays nothing for it, and importing it loads
neither rerun nor matplotlib: `record` and `picture` import them on use.

- `record` writes a rerun recording: `fgrecon.viz.recording`, laid out by `fgrecon.viz.blueprint` under the names of
  `fgrecon.viz.entities`; `fgrecon.replay` reads it back.
- `picture`, `contact_sheet` and `save_picture` draw without a viewer: `fgrecon.viz.picture`.
- Both share colours (`fgrecon.viz.style`), geometry (`fgrecon.viz.geometry`) and `Truth`.
"""

from fgrecon.viz.recording import log_reconstruction, record
from fgrecon.viz.truth import Truth

__all__ = ["Truth", "log_reconstruction", "record"]
