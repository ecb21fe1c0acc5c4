"""Options from settings by their names alone, whichever group they are in."""

from fgrecon.core.options import BoxOptions, KeypointOptions, Options, SearchOptions, ShapeOptions

GROUPS = {"keypoints": KeypointOptions, "box": BoxOptions, "shape": ShapeOptions, "search": SearchOptions}


def options(**settings):
    """`Options` with each setting in its group, the graph's before the search's; those of the box are `box_...`."""
    grouped = {}
    for name, value in settings.items():
        if name.startswith("box_"):
            grouped.setdefault("box", {})[name.removeprefix("box_")] = value
        else:
            home = [group for group, kind in GROUPS.items() if group != "box" and name in kind.__dataclass_fields__]
            (grouped.setdefault(home[0], {}) if home else grouped)[name] = value
    return Options(**{name: GROUPS[name](**value) if name in GROUPS else value for name, value in grouped.items()})
