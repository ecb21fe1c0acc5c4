"""Chart of a car in a video over time: heading, speed and size with their bands, probability of another pose."""

from __future__ import annotations

from typing import Any

from fgrecon.app.videos import Band, CarMoment, FollowedCar

_SIZES = ("length", "width", "height")
_ROWS = (("heading °", ("heading",)), ("speed km/h", ("speed",)), (f"size m: {', '.join(_SIZES)}", _SIZES))
_OTHER = "other pose"
_COLOURS = {"heading": "#3d85c8", "speed": "#2a9d6f", "length": "#b5651d", "width": "#8e6bbf", "height": "#c0392b"}
_HEIGHT, _GAP, _TOP = 110, 34, 24  # pixels of a row and between rows
_GREY = {"color": "#888"}

HEIGHT = _TOP + (len(_ROWS) + 1) * (_HEIGHT + _GAP)
"""Of the chart, pixels."""


def chart_of(car: FollowedCar) -> dict[str, Any]:
    """The options of an ECharts chart; times are seconds."""
    series: list[dict[str, Any]] = []
    for row, (_, names) in enumerate(_ROWS):
        for name in names:
            series += _band(car, name, row)
    shares = [[moment.time, max((share for _, share in moment.others), default=None)] for moment in car.moments]
    last = len(_ROWS)
    series.append({"name": _OTHER, "type": "line", "symbolSize": 4, "data": shares, **_at(last), "color": "#888"})
    titles = [*(title for title, _ in _ROWS), "probability of another pose"]
    rows = range(len(titles))
    axis = {"type": "value", "scale": True, "axisLabel": _GREY, "splitLine": {"lineStyle": {"opacity": 0.3}}}
    lowest = {last: {"min": 0, "max": 1}}
    return {
        "animation": False,
        "textStyle": _GREY,
        "title": [
            {"text": t, "left": 4, "top": _top(n) - 20, "textStyle": {**_GREY, "fontSize": 12}}
            for n, t in enumerate(titles)
        ],
        "tooltip": {"trigger": "axis"},
        "axisPointer": {"link": [{"xAxisIndex": "all"}]},
        "grid": [{"left": 44, "right": 12, "top": _top(n), "height": _HEIGHT - 20} for n in rows],
        "xAxis": [{"type": "value", "gridIndex": n, "scale": True, "axisLabel": _GREY} for n in rows],
        "yAxis": [{**axis, "gridIndex": n, **lowest.get(n, {})} for n in rows],
        "series": series,
    }


def in_words(car: FollowedCar, moment: CarMoment) -> str:
    """A car at a moment, in a sentence."""
    bands = {name: _band_text(*band) for name, band in moment.bands.items()}
    size = " x ".join(bands[name] for name in _SIZES)
    words = f"Car {car.name} at {moment.time:.2f} s: heading {bands['heading']}°, speed {bands['speed']} km/h, {size} m"
    others = "; ".join(f"heading {heading:.0f}° with probability {share:.2f}" for heading, share in moment.others)
    return f"{words}. Other poses: {others or 'none'}."


def _band_text(value: float | None, low: float | None, high: float | None) -> str:
    if value is None:
        return "unknown"
    return f"{value:.1f}" if low is None or high is None else f"{value:.1f} ({low:.1f} to {high:.1f})"


def _top(row: int) -> int:
    return _TOP + row * (_HEIGHT + _GAP)


def _at(row: int) -> dict[str, Any]:
    return {"xAxisIndex": row, "yAxisIndex": row}


def _band(car: FollowedCar, name: str, row: int) -> list[dict[str, Any]]:
    """A value over time and the region of its band: an area on top of one that is not seen."""
    bands: list[tuple[float, Band]] = [(moment.time, moment.bands[name]) for moment in car.moments]
    known = [(time, low, high) for time, (_, low, high) in bands if low is not None and high is not None]
    region = {"type": "line", "stack": name, "stackStrategy": "all", "symbol": "none", "silent": True, **_at(row)}
    region |= {"lineStyle": {"opacity": 0}, "tooltip": {"show": False}}
    filled = {"color": _COLOURS[name], "opacity": 0.2}
    return [
        {**region, "data": [[time, low] for time, low, _ in known]},
        {**region, "data": [[time, high - low] for time, low, high in known], "areaStyle": filled},
        {
            "name": name,
            "type": "line",
            "symbolSize": 4,
            "color": _COLOURS[name],
            "data": [[time, value] for time, (value, _, _) in bands],
            **_at(row),
        },
    ]
