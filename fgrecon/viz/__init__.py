"""Recordings and pictures of a reconstruction, made after solving from its history.

Nothing that computes imports this package, so a solve that is not drawn pays nothing for it, and importing it loads
neither rerun nor matplotlib: they are imported on use.

- `record` writes a rerun recording: `fgrecon.viz.recording`, laid out by `fgrecon.viz.blueprint` under the names of
  `fgrecon.viz.entities`; `fgrecon.viz.replay` reads it back. `record_scene` does the same for all vehicles of an image,
  `record_track` for a whole track, and a `Recording` can also be sent to a viewer.
- `scene_picture` draws all vehicles of an image and the scene from above: `fgrecon.viz.scene_picture`. `picture`,
  `contact_sheet` and `save_picture` draw without a viewer too: `fgrecon.viz.picture`; `animate` writes the optimisation
  as GIF or MP4.
- Both share colours (`fgrecon.viz.style`), geometry (`fgrecon.viz.geometry`), words (`fgrecon.viz.describe`) and
  `Truth`.
"""

from fgrecon.viz.animation import animate
from fgrecon.viz.overlay import Shown
from fgrecon.viz.photograph import Photograph
from fgrecon.viz.picture import Sight, as_rgb, contact_sheet, picture, save_picture
from fgrecon.viz.recording import record, recording_of
from fgrecon.viz.scene_picture import scene_picture
from fgrecon.viz.scene_recording import record_scene, scene_recording_of
from fgrecon.viz.sinks import Recording
from fgrecon.viz.track_recording import record_track, track_recording_of
from fgrecon.viz.track_sight import TrackSight
from fgrecon.viz.truth import Truth

__all__ = [
    "Photograph",
    "Recording",
    "Shown",
    "Sight",
    "TrackSight",
    "Truth",
    "animate",
    "as_rgb",
    "contact_sheet",
    "picture",
    "record",
    "record_scene",
    "record_track",
    "recording_of",
    "save_picture",
    "scene_picture",
    "scene_recording_of",
    "track_recording_of",
]
