"""datumaro's own file of a vehicle below FOLDER < JSON of its box and its points by name."""

import json
import sys

import datumaro
from datumaro.components.annotation import AnnotationType, Bbox, LabelCategories, Points, PointsCategories

given = json.load(sys.stdin)
x1, y1, x2, y2 = given["box"]
values = [value for point in given["points"].values() for value in point]
points = Points(values, [2] * len(given["points"]), label=0, group=4)
box = Bbox(x1, y1, x2 - x1, y2 - y1, label=0, group=4)
labels = LabelCategories.from_iterable(["car"])
names = PointsCategories.from_iterable([(0, list(given["points"]))])
categories = {AnnotationType.label: labels, AnnotationType.points: names}
item = datumaro.DatasetItem(id="street", annotations=[points, box])
datumaro.Dataset.from_iterable([item], categories=categories).export(sys.argv[1], "datumaro")
