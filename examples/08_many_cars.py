"""Many cars at once: a table in, a table out, which any engine that maps tables can do.

Every row has a factor graph of its own, and a row that cannot be solved says why:

     N(0, I) ---- L(0) ----+                N(0, I) ---- L(0) ----+
                (lambda)   |                           (lambda)   |
                     reprojection_i  ...                    reprojection_i
                           |                                      |
       ground ---- X(0,0) -+                  ground ---- X(0,0) -+
            row 0                                   row 1
"""

import numpy as np
import pyarrow as pa

import fgrecon
from fgrecon.batch import Reconstructor
from fgrecon.simulation import KITTI_CAMERA, Vehicle, simulate, yaw_pose


def main() -> None:
    rng = np.random.default_rng(1)
    prior = fgrecon.load_prior("car14")
    rows, true_yaws = [], []
    for number in range(6):
        yaw, place = rng.uniform(-3, 3), np.array([rng.uniform(-5, 5), 1.65, rng.uniform(8, 20)])
        car = Vehicle.of_prior(prior, coefficients=rng.normal(size=prior.dimension))
        seen, _ = simulate(car, KITTI_CAMERA, yaw_pose(yaw, place), rng)
        columns = {"keypoints": seen.keypoints, "confidence": seen.confidence, "box": seen.box}
        rows.append({"id": f"car-{number}", **{name: np.asarray(value).tolist() for name, value in columns.items()}})
        true_yaws.append(yaw)
    rows[4]["box"] = [5.0, 5.0, 5.0, 9.0]  # a box without width

    reconstructor = Reconstructor(camera=KITTI_CAMERA, ground=1.65)  # pickles small: send it to workers
    table = reconstructor(pa.Table.from_pylist(rows))

    for row, true_yaw in zip(table.to_pylist(), true_yaws, strict=True):
        if row["status"] == "refused":
            print(f"{row['id']}: refused: {row['error']}")
        else:
            yaw, true = np.degrees([row["rotation_y"], true_yaw])
            print(f"{row['id']}: {row['status']}, yaw {yaw:.1f} degrees, true {true:.1f}")


if __name__ == "__main__":
    main()
