"""Recordings and pictures of a reconstruction, made after solving from its history.

Nothing that computes imports this package, so a solve that is not drawn pays nothing for it, and importing it loads
neither rerun nor matplotlib: they are imported on use.

- What is drawn is in `fgrecon.viz.subjects`: a `SolvedVehicle`, the `TrackInputs` of a track, a `DrawnVehicle` for each
  vehicle of a scene; and `Truth`.
- `recording_of`, `scene_recording_of` and `track_recording_of` give a `Recording`, which can be written to a file, sent
  to a viewer or shown in a notebook. Entities have the names of `fgrecon.viz.entities`, `fgrecon.viz.blueprint` lays
  them out, and `fgrecon.viz.replay` reads a file back.
- `scene_picture` draws all vehicles of an image and the scene from above; `picture` and `contact_sheet` draw single
  ones; `save_picture` writes what they drew. `animate` writes an optimisation as GIF or MP4.
- All share colours (`fgrecon.viz.style`), geometry (`fgrecon.viz.geometry`) and words (`fgrecon.viz.describe`).
"""

from typing import TYPE_CHECKING

from factors.lazy import lazy_names
from fgrecon.viz.animation import animate
from fgrecon.viz.picture import as_rgb, contact_sheet, picture, save_picture
from fgrecon.viz.scene_picture import scene_picture
from fgrecon.viz.sinks import Recording
from fgrecon.viz.subjects import DrawnVehicle, Photograph, SolvedVehicle, TrackInputs, Truth

if TYPE_CHECKING:  # imported when used, since they import rerun
    from fgrecon.viz.recording import recording_of
    from fgrecon.viz.scene_recording import scene_recording_of
    from fgrecon.viz.track_recording import track_recording_of

__all__ = [
    "DrawnVehicle",
    "Photograph",
    "Recording",
    "SolvedVehicle",
    "TrackInputs",
    "Truth",
    "animate",
    "as_rgb",
    "contact_sheet",
    "picture",
    "recording_of",
    "save_picture",
    "scene_picture",
    "scene_recording_of",
    "track_recording_of",
]

__getattr__, __dir__ = lazy_names(__name__)
