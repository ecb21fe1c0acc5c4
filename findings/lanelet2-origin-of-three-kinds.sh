#!/usr/bin/env bash
# lanelet2 1.2.3, UtmProjector, MercatorProjector and LocalCartesianProjector of maps, each made with Origin(latitude, longitude, altitude).
#
# Guess: the origin comes to (0, 0, 0) ("all projectors in Lanelet2 work in local coordinates", says its author in issue 181), and a point
# 30 m higher has z = 30; which projector a map is read by matters to the metre at most.
# Seen: LocalCartesianProjector does so. UtmProjector takes off x and y but not the altitude, which stands in z as it is (here 330 instead of 30); of
# MercatorProjector's origin only the scale is taken, so that the map lies 613 km east and 4116 km north of it. UtmProjector's axes are turned
# by half a degree against north as well, as its grid is: 8 m at a distance of a kilometre. (Pull request 244 tells of shifts between projectors.)
set -euo pipefail
folder=$(mktemp -d); trap 'rm -rf "$folder"' EXIT; cd "$folder"
python3 -m venv env && env/bin/pip install --quiet lanelet2==1.2.3 numpy==2.3.5
env/bin/python - <<'PYTHON'
import lanelet2
import numpy as np
from lanelet2.core import GPSPoint

latitude, longitude, altitude = 49.0, 8.4, 300.0
origin = lanelet2.io.Origin(latitude, longitude, altitude)
above, northward = GPSPoint(latitude, longitude, altitude + 30), GPSPoint(latitude + 0.009, longitude, altitude)
places = {}
for name in ("LocalCartesianProjector", "UtmProjector", "MercatorProjector"):
    projector = getattr(lanelet2.projection, name)(origin)
    places[name] = np.array([[point.x, point.y, point.z] for point in map(projector.forward, (above, northward))])
    print(f"{name}: 30 m above the origin {places[name][0].round(2)}, a kilometre north of it {places[name][1].round(2)}")
local, utm, mercator = places.values()
assert np.allclose(local[0], [0, 0, 30], atol=1e-3) and abs(local[1, 0]) < 1e-3
assert np.allclose(utm[0], [0, 0, altitude + 30], atol=1e-3)
turned = np.degrees(np.arctan2(utm[1, 0], utm[1, 1]))
convergence = np.degrees(np.arctan(np.tan(np.radians(longitude - 9)) * np.sin(np.radians(latitude))))  # of zone 32, its middle at 9 degrees
print(f"grid north of UtmProjector is turned by {turned:.3f} degrees, as the zone's meridians converge by {convergence:.3f}")
assert np.isclose(turned, -convergence, atol=0.01)
radius = 6378137 * np.cos(np.radians(latitude))
expected = radius * np.array([np.radians(longitude), np.log(np.tan(np.pi / 4 + np.radians(latitude) / 2))])
assert np.allclose(mercator[0, :2], expected, rtol=1e-6) and mercator[0, 2] == altitude + 30
PYTHON
